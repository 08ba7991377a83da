//! Goal table. Which goals are there, and how do they end? Every change becomes a record; a goal ends exactly once.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use zenav_protocol::messages::{
    GoalFeedback, GoalPhase, GoalReply, GoalRequest, GoalState, GoalsReply, GoalsRequest, Refusal,
};
use zenav_protocol::time::Stamp;

use super::records::{QueueOrder, Record, StoredGoal};

/// Ended goals kept: the window within which a goal's id is recognised.
const MAX_ENDED: usize = 1000;
/// Most queued goals.
const MAX_WAITING: usize = 100;
/// First answers kept: the window within which a request's id is recognised.
const MAX_ANSWERS: usize = 256;
/// Ended goals published again at the start: an end may have been stored but not published.
const TOLD_AGAIN: usize = 32;
/// Default number of goals in an answer.
const DEFAULT_LIMIT: usize = 100;

/// All goals of one robot.
///
/// A goal resubmitted under the same id is the same goal, and a request repeated under its id gets its first answer. Both are remembered
/// within a window: all open goals, the last 1,000 ended ones and the last 256 answers. An older id means a new goal, so a client should
/// not resend a goal after a thousand others have ended.
#[derive(Clone, Debug, Default)]
pub struct GoalTable {
    goals: BTreeMap<u64, StoredGoal>,
    by_id: BTreeMap<String, u64>,
    /// Goals that have not ended.
    open: BTreeSet<u64>,
    answers: VecDeque<(String, GoalReply)>,
    records: Vec<Record>,
    changed: BTreeSet<u64>,
    /// Last published positions in the queue.
    told_places: BTreeMap<u64, u64>,
}

impl GoalTable {
    /// A table with the stored goals and answers.
    #[must_use]
    pub fn new(goals: Vec<StoredGoal>, answers: Vec<(String, GoalReply)>) -> Self {
        let goals: BTreeMap<u64, StoredGoal> = goals.into_iter().map(|goal| (goal.sequence, goal)).collect();
        let by_id = goals
            .iter()
            .map(|(sequence, goal)| (goal.state.id.clone(), *sequence))
            .collect();
        let open: BTreeSet<u64> = goals
            .values()
            .filter(|goal| !goal.state.state.is_end())
            .map(|goal| goal.sequence)
            .collect();
        let ended = goals.values().rev().filter(|goal| goal.state.state.is_end());
        let ended = ended.map(|goal| goal.sequence).take(TOLD_AGAIN);
        Self {
            changed: open.iter().copied().chain(ended).collect(),
            goals,
            by_id,
            open,
            answers: answers.into(),
            records: Vec::new(),
            told_places: BTreeMap::new(),
        }
    }

    /// A goal by its id.
    #[must_use]
    pub fn get(&self, id: &str) -> Option<&StoredGoal> {
        self.by_id.get(id).and_then(|sequence| self.goals.get(sequence))
    }

    /// The goal that is active or paused.
    #[must_use]
    pub fn active(&self) -> Option<&StoredGoal> {
        self.open()
            .find(|goal| matches!(goal.state.state, GoalPhase::Active | GoalPhase::Paused))
    }

    /// The first goal of the queue: preempting goals first, then by priority, then by age.
    ///
    /// ```
    /// use zenav_mission::GoalTable;
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let mut goals = GoalTable::default();
    /// for (id, priority) in [("sweep", 0), ("deliver", 5)] {
    ///     goals.accept("tiago", id.into(), GoalRequest { priority, ..GoalRequest::default() }, false, Stamp::from_secs(1.0));
    /// }
    /// assert_eq!(goals.next().unwrap().state.id, "deliver");
    /// ```
    #[must_use]
    pub fn next(&self) -> Option<&StoredGoal> {
        self.waiting().min_by_key(|goal| goal.turn().key())
    }

    /// Waiting goals, the next one first.
    fn queue(&self) -> Vec<&StoredGoal> {
        let mut queue: Vec<&StoredGoal> = self.waiting().collect();
        queue.sort_by_key(|goal| goal.turn().key());
        queue
    }

    /// Positions in the queue, from 1, by number of the goal.
    fn places(&self) -> BTreeMap<u64, u64> {
        self.queue().into_iter().map(|goal| goal.sequence).zip(1..).collect()
    }

    /// Moves a waiting goal before another one, or to the end. It takes on the other's urgency and priority; the order numbers of the goals
    /// with this urgency and priority are then reassigned in the new order.
    ///
    /// # Errors
    /// [`Refusal::Rejected`] for a goal that is not waiting.
    ///
    /// ```
    /// use zenav_mission::GoalTable;
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let mut goals = GoalTable::default();
    /// for id in ["a", "b", "c"] {
    ///     goals.accept("tiago", id.into(), GoalRequest::default(), false, Stamp::from_secs(1.0));
    /// }
    /// goals.move_before("c", Some("a"))?;
    /// assert_eq!(goals.next().unwrap().state.id, "c");
    /// assert!(goals.move_before("d", None).is_err(), "there is no such goal");
    /// # Ok::<(), zenav_protocol::messages::Refusal>(())
    /// ```
    pub fn move_before(&mut self, id: &str, before: Option<&str>) -> Result<(), Refusal> {
        let queue = self.queue();
        let place = |id: &str| {
            queue.iter().position(|goal| goal.state.id == id).ok_or_else(|| {
                let phase = self.get(id).map(|goal| goal.state.state);
                let phase = phase.map_or_else(|| "unknown".to_owned(), |phase| format!("{phase:?}"));
                Refusal::rejected(format!("goal {id} is {phase}: only goals that wait can be moved"))
            })
        };
        let moved = place(id)?;
        let at = before.map(place).transpose()?;
        if at == Some(moved) {
            return Ok(());
        }
        let Some(class) = at
            .map_or_else(|| queue.last(), |at| queue.get(at))
            .map(|goal| goal.turn())
        else {
            return Ok(());
        };
        let mut order: Vec<(u64, QueueOrder)> = queue.iter().map(|goal| (goal.sequence, goal.turn())).collect();
        let (sequence, turn) = order.remove(moved);
        let at = at.map_or(order.len(), |at| if at > moved { at - 1 } else { at });
        let number = turn.number;
        order.insert(at, (sequence, QueueOrder { number, ..class }));
        order.retain(|(_, turn)| turn.is_beside(&class));
        let mut numbers: Vec<u64> = order.iter().map(|(_, turn)| turn.number).collect();
        numbers.sort_unstable();
        for ((sequence, turn), number) in order.into_iter().zip(numbers) {
            let turn = QueueOrder { number, ..turn };
            if let Some(goal) = self.goals.get_mut(&sequence).filter(|goal| goal.turn() != turn) {
                goal.moved = Some(turn);
                self.store(sequence);
            }
        }
        Ok(())
    }

    fn waiting(&self) -> impl Iterator<Item = &StoredGoal> {
        self.open().filter(|goal| goal.state.state == GoalPhase::Accepted)
    }

    /// Goals that have not ended, in the order of acceptance.
    pub fn open(&self) -> impl Iterator<Item = &StoredGoal> {
        self.open.iter().filter_map(|sequence| self.goals.get(sequence))
    }

    /// The length of the queue.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.waiting().count()
    }

    /// Whether the queue is full.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.queued() >= MAX_WAITING
    }

    /// The order number of the next goal.
    #[must_use]
    pub fn next_sequence(&self) -> u64 {
        self.goals
            .last_key_value()
            .map_or(1, |(last, _)| last.saturating_add(1))
    }

    /// Accepts a validated goal.
    pub fn accept(&mut self, robot: &str, id: String, request: GoalRequest, urgent: bool, now: Stamp) {
        let sequence = self.next_sequence();
        let goal = StoredGoal::accepted(sequence, robot, id.clone(), request, urgent, now);
        self.by_id.insert(id, sequence);
        self.open.insert(sequence);
        self.goals.insert(sequence, goal);
        self.store(sequence);
        self.forget_old();
    }

    /// Changes a goal that has not ended; stores and publishes it.
    pub fn change(&mut self, id: &str, change: impl FnOnce(&mut StoredGoal)) {
        let Some(sequence) = self.by_id.get(id).copied() else {
            return;
        };
        if let Some(goal) = self.goals.get_mut(&sequence).filter(|goal| !goal.state.state.is_end()) {
            change(goal);
            self.store(sequence);
        }
    }

    /// Updates a goal's feedback; published, not stored.
    pub fn feed_back(&mut self, id: &str, feedback: &GoalFeedback) {
        let Some(sequence) = self.by_id.get(id).copied() else {
            return;
        };
        if let Some(goal) = self.goals.get_mut(&sequence).filter(|goal| !goal.state.state.is_end()) {
            goal.state.feedback = feedback.clone();
            self.changed.insert(sequence);
        }
    }

    /// Ends a goal; `false` if it is unknown or has already ended.
    ///
    /// ```
    /// use zenav_mission::GoalTable;
    /// use zenav_protocol::messages::{GoalPhase, GoalRequest};
    /// use zenav_protocol::time::Stamp;
    ///
    /// let mut goals = GoalTable::default();
    /// goals.accept("tiago", "a".into(), GoalRequest::default(), false, Stamp::from_secs(1.0));
    /// assert!(goals.end("a", GoalPhase::Succeeded, None, Stamp::from_secs(9.0)));
    /// assert!(!goals.end("a", GoalPhase::Aborted, Some("too late".into()), Stamp::from_secs(9.1)));
    /// assert_eq!(goals.get("a").unwrap().state.state, GoalPhase::Succeeded);
    /// ```
    pub fn end(&mut self, id: &str, state: GoalPhase, reason: Option<String>, now: Stamp) -> bool {
        let ends = self.get(id).is_some_and(|goal| !goal.state.state.is_end()) && state.is_end();
        if ends {
            self.change(id, |goal| {
                goal.state.state = state;
                goal.state.reason = reason;
                goal.state.ended = Some(now);
            });
            self.open
                .retain(|sequence| self.goals.get(sequence).is_some_and(|goal| goal.state.id != id));
        }
        ends
    }

    fn store(&mut self, sequence: u64) {
        if let Some(goal) = self.goals.get(&sequence) {
            self.records.push(Record::Goal(Box::new(goal.clone())));
            self.changed.insert(sequence);
        }
    }

    fn forget_old(&mut self) {
        let ended: Vec<u64> = self
            .goals
            .values()
            .filter(|goal| goal.state.state.is_end())
            .map(|goal| goal.sequence)
            .collect();
        for sequence in ended.iter().take(ended.len().saturating_sub(MAX_ENDED)) {
            if let Some(goal) = self.goals.remove(sequence) {
                self.by_id.remove(&goal.state.id);
                self.records.push(Record::ForgetGoal(goal.state.id));
            }
        }
    }

    /// The answer to a resubmitted goal: its state, or a refusal if the id belongs to a different goal. `None` for a new id.
    ///
    /// ```
    /// use zenav_mission::GoalTable;
    /// use zenav_protocol::messages::GoalRequest;
    /// use zenav_protocol::time::Stamp;
    ///
    /// let goal = GoalRequest { id: Some("a".into()), x: Some(1.0), y: Some(2.0), ..GoalRequest::default() };
    /// let mut goals = GoalTable::default();
    /// assert!(goals.resubmitted(&goal).is_none());
    /// goals.accept("tiago", "a".into(), goal.clone(), false, Stamp::from_secs(1.0));
    /// assert!(matches!(goals.resubmitted(&goal), Some(Ok(_))));
    /// assert!(matches!(goals.resubmitted(&GoalRequest { x: Some(7.0), ..goal }), Some(Err(_))));
    /// ```
    #[must_use]
    pub fn resubmitted(&self, request: &GoalRequest) -> Option<Result<GoalReply, Refusal>> {
        let known = self.get(request.id.as_ref()?)?;
        if known.state.request == *request {
            return Some(Ok(goal_reply(&known.state)));
        }
        let id = &known.state.id;
        Some(Err(Refusal::rejected(format!(
            "goal {id} exists with different content"
        ))))
    }

    /// The first answer to a request, if it is remembered.
    #[must_use]
    pub fn answered(&self, request_id: &str) -> Option<&GoalReply> {
        self.answers
            .iter()
            .find(|(known, _)| known == request_id)
            .map(|(_, reply)| reply)
    }

    /// Remembers the first answer to a request.
    pub fn keep_answer(&mut self, request_id: String, reply: GoalReply) {
        if self.answers.len() >= MAX_ANSWERS
            && let Some((old, _)) = self.answers.pop_front()
        {
            self.records.push(Record::ForgetAnswer(old));
        }
        self.records.push(Record::Answer(request_id.clone(), reply.clone()));
        self.answers.push_back((request_id, reply));
    }

    /// Takes the records to store.
    pub fn take_records(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.records)
    }

    /// Takes the goals to publish.
    pub fn take_changed(&mut self) -> Vec<GoalState> {
        let places = self.places();
        let mut changed = std::mem::take(&mut self.changed);
        let moved = places
            .iter()
            .filter(|&(sequence, place)| self.told_places.get(sequence) != Some(place));
        changed.extend(moved.map(|(sequence, _)| *sequence));
        let goals = changed.iter().filter_map(|sequence| self.goals.get(sequence));
        let states = goals.map(|goal| shown(goal, &places)).collect();
        self.told_places = places;
        states
    }

    /// Goals by state or id, newest first.
    ///
    /// # Errors
    /// [`Refusal::NotFound`] for an unknown id.
    ///
    /// ```
    /// use zenav_mission::GoalTable;
    /// use zenav_protocol::messages::{GoalPhase, GoalRequest, GoalsRequest};
    /// use zenav_protocol::time::Stamp;
    ///
    /// let mut goals = GoalTable::default();
    /// for id in ["a", "b", "c"] {
    ///     goals.accept("tiago", id.into(), GoalRequest::default(), false, Stamp::from_secs(1.0));
    /// }
    /// goals.end("b", GoalPhase::Canceled, None, Stamp::from_secs(2.0));
    /// let waiting = GoalsRequest { states: vec![GoalPhase::Accepted], ..GoalsRequest::default() };
    /// let listed = goals.list(&waiting)?.goals;
    /// assert_eq!(listed.iter().map(|goal| (&*goal.id, goal.queue)).collect::<Vec<_>>(), [("c", Some(2)), ("a", Some(1))]);
    /// # Ok::<(), zenav_protocol::messages::Refusal>(())
    /// ```
    pub fn list(&self, request: &GoalsRequest) -> Result<GoalsReply, Refusal> {
        if let Some(id) = &request.id
            && self.get(id).is_none()
        {
            return Err(Refusal::NotFound {
                what: format!("goal {id}"),
            });
        }
        let wanted = |goal: &&StoredGoal| {
            request.id.as_ref().is_none_or(|id| *id == goal.state.id)
                && (request.states.is_empty() || request.states.contains(&goal.state.state))
        };
        let limit = request.limit.unwrap_or(DEFAULT_LIMIT);
        let places = self.places();
        let goals = self
            .goals
            .values()
            .rev()
            .filter(wanted)
            .take(limit)
            .map(|goal| shown(goal, &places))
            .collect();
        Ok(GoalsReply { goals, now: None })
    }
}

/// A goal's state with its position in the queue.
fn shown(goal: &StoredGoal, places: &BTreeMap<u64, u64>) -> GoalState {
    GoalState {
        queue: places.get(&goal.sequence).copied(),
        ..goal.state.clone()
    }
}

/// A goal's state as a reply.
#[must_use]
pub fn goal_reply(goal: &GoalState) -> GoalReply {
    GoalReply {
        robot: None,
        id: goal.id.clone(),
        state: goal.state,
        reason: goal.reason.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(ids: &[&str]) -> GoalTable {
        let mut table = GoalTable::default();
        for id in ids {
            let request = GoalRequest {
                x: Some(1.0),
                y: Some(2.0),
                ..GoalRequest::default()
            };
            table.accept("r", (*id).to_owned(), request, false, Stamp(1));
        }
        table
    }

    #[test]
    fn an_end_comes_once() {
        let mut table = table(&["a"]);
        assert!(table.end("a", GoalPhase::Succeeded, None, Stamp(2)));
        assert!(!table.end("a", GoalPhase::Aborted, Some("late".into()), Stamp(3)));
        assert_eq!(table.get("a").unwrap().state.state, GoalPhase::Succeeded);
        let ends = table
            .take_records()
            .into_iter()
            .filter(|record| matches!(record, Record::Goal(goal) if goal.state.state.is_end()));
        assert_eq!(ends.count(), 1);
        assert!(!table.end("a", GoalPhase::Active, None, Stamp(3)));
    }

    #[test]
    fn a_goal_sent_again_is_the_same_and_its_id_is_no_other_goal_s() {
        let table = table(&["a"]);
        let mut request = GoalRequest {
            id: Some("a".into()),
            ..table.get("a").unwrap().state.request.clone()
        };
        assert!(matches!(
            table.resubmitted(&request),
            Some(Err(Refusal::Rejected { .. }))
        ));
        request.id = None;
        assert_eq!(table.resubmitted(&request), None);
    }

    #[test]
    fn the_queue_is_ordered_by_preemption_priority_and_age() {
        let mut table = table(&["a", "b"]);
        assert_eq!(table.next().unwrap().state.id, "a");
        table.accept("r", "c".into(), GoalRequest::default(), true, Stamp(2));
        assert_eq!(table.next().unwrap().state.id, "c");
        assert_eq!(table.queued(), 3);
        let first = GoalRequest {
            priority: 5,
            ..GoalRequest::default()
        };
        table.accept("r", "d".into(), first, false, Stamp(3));
        assert_eq!(table.next().unwrap().state.id, "c", "urgent goes before any priority");
        assert!(table.end("c", GoalPhase::Canceled, None, Stamp(4)));
        assert_eq!(table.next().unwrap().state.id, "d", "then the greatest priority");
    }

    fn queue_of(table: &GoalTable) -> Vec<&str> {
        table.queue().into_iter().map(|goal| goal.state.id.as_str()).collect()
    }

    #[test]
    fn a_waiting_goal_is_moved_and_stays_there_after_a_restart() {
        let mut table = table(&["a", "b", "c", "d"]);
        table.move_before("d", Some("b")).unwrap();
        assert_eq!(queue_of(&table), ["a", "d", "b", "c"]);
        table.move_before("a", None).unwrap();
        assert_eq!(queue_of(&table), ["d", "b", "c", "a"]);
        table.move_before("d", Some("a")).unwrap();
        assert_eq!(queue_of(&table), ["b", "c", "d", "a"]);
        let mut stored: BTreeMap<u64, StoredGoal> = BTreeMap::new();
        for record in table.take_records() {
            if let Record::Goal(goal) = record {
                stored.insert(goal.sequence, *goal);
            }
        }
        let mut restored = GoalTable::new(stored.into_values().collect(), Vec::new());
        assert_eq!(queue_of(&restored), ["b", "c", "d", "a"]);
        restored.accept("r", "e".into(), GoalRequest::default(), false, Stamp(2));
        assert_eq!(queue_of(&restored), ["b", "c", "d", "a", "e"], "a new goal is the last");
    }

    #[test]
    fn a_moved_goal_takes_the_priority_of_the_one_that_it_is_put_before() {
        let mut table = table(&["a", "b"]);
        let request = |priority| GoalRequest {
            priority,
            ..GoalRequest::default()
        };
        table.accept("r", "first".into(), request(5), false, Stamp(2));
        table.accept("r", "urgent".into(), request(0), true, Stamp(2));
        assert_eq!(queue_of(&table), ["urgent", "first", "a", "b"]);
        table.move_before("b", Some("first")).unwrap();
        assert_eq!(queue_of(&table), ["urgent", "b", "first", "a"]);
        table.move_before("urgent", None).unwrap();
        assert_eq!(queue_of(&table), ["b", "first", "a", "urgent"]);
        table.accept("r", "c".into(), request(1), false, Stamp(3));
        assert_eq!(queue_of(&table), ["b", "first", "c", "a", "urgent"]);
        assert_eq!(
            table.get("b").unwrap().state.request.priority,
            0,
            "the request stays as it came"
        );
    }

    #[test]
    fn only_waiting_goals_are_moved() {
        let mut table = table(&["a", "b"]);
        table.change("a", |goal| goal.state.state = GoalPhase::Active);
        let refusal = table.move_before("a", None).unwrap_err().to_string();
        assert!(refusal.contains("goal a is Active"), "{refusal}");
        assert!(table.move_before("b", Some("a")).is_err());
        table.move_before("b", Some("b")).unwrap();
        table.move_before("b", None).unwrap();
        assert_eq!(queue_of(&table), ["b"]);
    }

    #[test]
    fn whoever_moves_up_is_told_again_with_its_place() {
        let mut table = table(&["a", "b", "c"]);
        let places = |table: &mut GoalTable| {
            let told = table.take_changed().into_iter();
            told.map(|goal| (goal.id, goal.queue)).collect::<Vec<_>>()
        };
        let told = |id: &str, place| (id.to_owned(), place);
        assert_eq!(
            places(&mut table),
            [told("a", Some(1)), told("b", Some(2)), told("c", Some(3))]
        );
        table.change("a", |goal| goal.state.state = GoalPhase::Active);
        assert_eq!(
            places(&mut table),
            [told("a", None), told("b", Some(1)), told("c", Some(2))]
        );
        assert!(places(&mut table).is_empty());
        table.move_before("c", Some("b")).unwrap();
        assert_eq!(places(&mut table), [told("b", Some(2)), told("c", Some(1))]);
        let listed = table.list(&GoalsRequest::default()).unwrap().goals;
        assert_eq!(listed[0].queue, Some(1));
    }

    #[test]
    fn lists_are_newest_first_filtered_and_bounded() {
        let mut table = table(&["a", "b", "c"]);
        table.end("b", GoalPhase::Canceled, None, Stamp(2));
        let ids = |request: &GoalsRequest| {
            table
                .list(request)
                .unwrap()
                .goals
                .into_iter()
                .map(|goal| goal.id)
                .collect::<Vec<_>>()
        };
        assert_eq!(ids(&GoalsRequest::default()), ["c", "b", "a"]);
        assert_eq!(
            ids(&GoalsRequest {
                states: vec![GoalPhase::Canceled],
                ..GoalsRequest::default()
            }),
            ["b"]
        );
        assert_eq!(
            ids(&GoalsRequest {
                limit: Some(1),
                ..GoalsRequest::default()
            }),
            ["c"]
        );
        assert!(matches!(
            table.list(&GoalsRequest {
                id: Some("x".into()),
                ..GoalsRequest::default()
            }),
            Err(Refusal::NotFound { .. })
        ));
    }

    #[test]
    fn old_ended_goals_are_forgotten_but_never_open_ones() {
        let mut table = table(&["open"]);
        for number in 0..MAX_ENDED + 50 {
            let id = format!("g{number}");
            table.accept("r", id.clone(), GoalRequest::default(), false, Stamp(1));
            table.end(&id, GoalPhase::Succeeded, None, Stamp(2));
        }
        table.accept("r", "last".into(), GoalRequest::default(), false, Stamp(1));
        assert!(table.goals.len() <= MAX_ENDED + 2 && table.get("open").is_some() && table.get("g0").is_none());
    }
}
