//! `zenav bt watch`: draws the tree that a mission runs, with the status of every node; after the goal's end, with the results.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use zenav_protocol::bus::Latest;
use zenav_protocol::messages::{GoalState, MissionStatus, NodeStatus};
use zenav_protocol::topics;

use crate::connect::{self, RobotArgs};
use crate::drawing::terminal;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::freshness::{Ages, Heard, OLD, RouterLink, dimmed, is_old};
use crate::inspect::diagnosis;
use crate::output::{self, Format};
use crate::record::{node_status, status_at_end, with_depths};

/// Period at which the ages are drawn anew.
const LOOK: Duration = Duration::from_millis(250);

pub(super) fn watch(robot: &RobotArgs, once: bool, format: Format) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let mut missions = bus.latest(&topics::MISSION, &[&robot])?;
        let mut goals = bus.latest(&topics::GOAL_STATE, &[&robot, "*"])?;
        let mut poses = bus.latest(&topics::POSE, &[&robot])?;
        let Some(status) = first(&mut missions, &robot, patience).await? else {
            return Ok(exit_code::INTERRUPTED);
        };
        let mut watched = Watched::new(status);
        if once {
            return output::value(format, &watched.status, |_| watched.picture(Paper::ENDLESS));
        }
        let mut link = RouterLink::new(&bus);
        let mut drawing = Drawing::new(format);
        drawing.print(&watched)?;
        let mut pace = tokio::time::interval(LOOK);
        loop {
            drawing.draw(&watched);
            tokio::select! {
                biased;
                _ = tokio::signal::ctrl_c() => return Ok(exit_code::INTERRUPTED),
                received = missions.next() => {
                    let received = received.ok_or_else(Failure::closed)?;
                    watched.hear(received.message);
                    drawing.print(&watched)?;
                }
                Some(goal) = goals.next() => watched.end(goal.message),
                _ = pace.tick() => {
                    if poses.take().is_some() {
                        watched.heard.pose = Some(Instant::now());
                    }
                    if let Some(news) = link.news().await {
                        drawing.tell(news);
                    }
                    drawing.tell_silence(&robot, watched.heard.ages());
                }
            }
        }
    })
}

/// The first status; `None` after Ctrl-C.
async fn first(
    missions: &mut Latest<MissionStatus>,
    robot: &str,
    patience: Duration,
) -> Result<Option<MissionStatus>, Failure> {
    let received = tokio::select! {
        biased;
        _ = tokio::signal::ctrl_c() => return Ok(None),
        received = tokio::time::timeout(patience, missions.next()) => received,
    };
    match received {
        Ok(Some(received)) => Ok(Some(received.message)),
        Ok(None) => Err(Failure::closed()),
        Err(_) => Err(Failure::timeout(format!(
            "no word from {} in time: does a mission run?",
            topics::MISSION.key(&[robot])
        ))),
    }
}

/// Where a tree is drawn.
#[derive(Clone, Copy, Debug)]
struct Paper {
    colors: bool,
    /// Rows and columns; `None`: as many as it takes.
    size: Option<(usize, usize)>,
    /// Whether the ages are drawn too.
    has_ages: bool,
}

impl Paper {
    const ENDLESS: Self = Self {
        colors: false,
        size: None,
        has_ages: false,
    };

    fn terminal() -> Self {
        let size = terminal::size().filter(|(_, rows)| *rows > 3);
        Self {
            colors: terminal::has_colors(),
            size: size.map(|(columns, rows)| (rows, columns)),
            has_ages: true,
        }
    }
}

/// Output of the command: one drawing that is overwritten on a terminal, otherwise one below the other, or every status as JSON.
struct Drawing {
    format: Format,
    is_live: bool,
    /// Rows of the drawing on the terminal.
    drawn: usize,
    last: String,
    was_silent: bool,
}

impl Drawing {
    fn new(format: Format) -> Self {
        Self {
            format,
            is_live: std::io::stdout().is_terminal() && format == Format::Table,
            drawn: 0,
            last: String::new(),
            was_silent: false,
        }
    }

    /// Prints a status for programs.
    fn print(&self, watched: &Watched) -> Outcome {
        match self.format {
            Format::Table => Ok(exit_code::OK),
            format => output::value(format.streamed(), &watched.status, |_| String::new()),
        }
    }

    /// Draws what has changed for people.
    fn draw(&mut self, watched: &Watched) {
        if self.format != Format::Table {
            return;
        }
        let paper = if self.is_live {
            Paper::terminal()
        } else {
            Paper::ENDLESS
        };
        let text = watched.picture(paper);
        if text == self.last {
            return;
        }
        output::line(&format!("{}{text}", self.erased()));
        self.drawn = if self.is_live { text.lines().count() } else { 0 };
        self.last = text;
    }

    /// What erases the drawing on the terminal.
    fn erased(&mut self) -> String {
        match std::mem::take(&mut self.drawn) {
            0 => String::new(),
            rows => format!("\x1b[{rows}A\x1b[J"),
        }
    }

    /// Prints a line above the drawing.
    fn tell(&mut self, news: &str) {
        if self.is_live {
            output::line(&format!("{}{news}", self.erased()));
            self.last.clear();
        } else {
            output::note(news);
        }
    }

    /// Without a terminal, tells once that the mission has fallen silent; on a terminal the ages do.
    fn tell_silence(&mut self, robot: &str, ages: Ages) {
        let is_silent = is_old(ages.mission);
        if is_silent && !self.was_silent && !self.is_live {
            self.tell(&format!(
                "zenav: the mission of {robot} is silent for {} s",
                OLD.as_secs()
            ));
        }
        self.was_silent = is_silent;
    }
}

/// What is known of a mission.
struct Watched {
    status: MissionStatus,
    heard: Heard,
    /// The last tree that ran.
    tree: Option<LastTree>,
}

/// A tree, after its goal's end with the results.
struct LastTree {
    name: String,
    goal_id: String,
    nodes: Vec<NodeStatus>,
    end: Option<GoalState>,
}

impl Watched {
    fn new(status: MissionStatus) -> Self {
        let mut watched = Self {
            status: status.clone(),
            heard: Heard::default(),
            tree: None,
        };
        watched.hear(status);
        watched
    }

    fn hear(&mut self, status: MissionStatus) {
        self.heard.mission = Some(Instant::now());
        let is_over = |tree: &LastTree| tree.end.is_some() && Some(&tree.goal_id) == status.goal_id.as_ref();
        if !status.nodes.is_empty() && !self.tree.as_ref().is_some_and(is_over) {
            self.tree = Some(LastTree {
                name: status.tree.clone().unwrap_or_default(),
                goal_id: status.goal_id.clone().unwrap_or_default(),
                nodes: status.nodes.clone(),
                end: None,
            });
        }
        self.status = status;
    }

    /// Takes in the end of the tree's goal: nodes that ran until then get its result.
    fn end(&mut self, goal: GoalState) {
        let Some(tree) = self.tree.as_mut().filter(|tree| tree.goal_id == goal.id) else {
            return;
        };
        if !goal.state.is_end() {
            return;
        }
        for node in tree.nodes.iter_mut().filter(|node| node.status == "RUNNING") {
            status_at_end(goal.state).clone_into(&mut node.status);
        }
        tree.end = Some(goal);
    }

    /// The tree, one node per row. If it has more nodes than there are rows, only the most informative ones are shown.
    fn picture(&self, paper: Paper) -> String {
        let status = &self.status;
        let leads = match status.leads {
            true => format!("leads, {}", diagnosis::standbys(status)),
            false => "does not lead".to_owned(),
        };
        let ages = self.heard.ages();
        let told = if paper.has_ages {
            format!("{}  ", ages.text())
        } else {
            String::new()
        };
        let mut lines = vec![
            cut(
                &format!("{told}{} {leads} (epoch {})", status.holder, status.epoch),
                paper,
            ),
            cut(&format!("{}, {} waiting", self.goal(), status.queued), paper),
        ];
        // What is drawn of a silent mission may be over.
        let is_stale = paper.has_ages && is_old(ages.mission);
        let rows = Paper {
            colors: paper.colors && !is_stale,
            ..paper
        };
        lines.extend(self.rows(rows));
        let faint = match (is_stale, paper.has_ages && ages.is_old()) {
            (true, _) => lines.len(),
            (false, true) => 1,
            (false, false) => 0,
        };
        for line in lines.iter_mut().take(faint) {
            *line = dimmed(line, paper.colors);
        }
        lines.join("\n")
    }

    /// The tree and its goal.
    fn goal(&self) -> String {
        match &self.tree {
            Some(LastTree { name, goal_id, end, .. }) => {
                let goal = match end {
                    Some(goal) => {
                        let reason = output::piece(goal.reason.as_ref(), |reason| format!(": {reason}"));
                        format!("{goal_id} {:?}{reason}", goal.state)
                    }
                    None if self.status.nodes.is_empty() => format!("{goal_id} has ended"),
                    None => goal_id.clone(),
                };
                format!("tree {name}: {goal}")
            }
            None => "tree none: no goal".to_owned(),
        }
    }

    fn rows(&self, paper: Paper) -> Vec<String> {
        let nodes = self.tree.as_ref().map(|tree| tree.nodes.as_slice()).unwrap_or_default();
        let shown = paper.size.map_or(usize::MAX, |(rows, _)| rows.saturating_sub(4));
        let least = shown_from(nodes, shown);
        let mut lines = Vec::new();
        let mut left_out = 0;
        for (at, (node, depth)) in with_depths(nodes).enumerate() {
            if (weight(node), at) <= least {
                lines.push(row(node, depth, paper));
            } else {
                left_out += 1;
            }
        }
        if left_out > 0 {
            lines.push(format!("… {left_out} more on a taller terminal"));
        }
        lines
    }
}

/// Display order of a node's status: 0 (running) is the most informative.
fn weight(node: &NodeStatus) -> u8 {
    match (node.status.as_str(), node_status(node)) {
        ("RUNNING", _) => 0,
        ("FAILURE", _) => 1,
        ("SUCCESS", _) => 2,
        (_, "FAILURE" | "SUCCESS") => 3,
        _ => 4,
    }
}

/// Weight and index of the last node that is shown if at most `most` nodes are.
fn shown_from(nodes: &[NodeStatus], most: usize) -> (u8, usize) {
    let mut order: Vec<(u8, usize)> = nodes.iter().enumerate().map(|(at, node)| (weight(node), at)).collect();
    order.sort_unstable();
    let last = most.min(order.len()).checked_sub(1);
    last.and_then(|last| order.get(last).copied()).unwrap_or_default()
}

/// A node; one that its parent has reset keeps the sign of its last result, in grey.
fn row(node: &NodeStatus, depth: usize, paper: Paper) -> String {
    let (sign, color) = match node_status(node) {
        "RUNNING" => ('▶', 33),
        "SUCCESS" => ('✓', 32),
        "FAILURE" => ('✗', 31),
        "SKIPPED" => ('-', 90),
        _ => ('·', 90),
    };
    let color = if node.status == "IDLE" { 90 } else { color };
    let id = output::piece(Some(&node.id).filter(|id| **id != node.name), |id| format!(" [{id}]"));
    let feedback = output::piece(Some(&node.feedback).filter(|text| !text.is_empty()), |text| {
        format!("  {text}")
    });
    let indent = "  ".repeat(depth.min(40));
    let text = cut(&format!("{indent}{sign} {}{id}{feedback}", node.name), paper);
    if paper.colors {
        text.replacen(sign, &format!("\x1b[{color}m{sign}\x1b[0m"), 1)
    } else {
        text
    }
}

/// A line as far as it fits into the columns. A multi-line feedback, or one with terminal escape codes, must not break the picture.
fn cut(line: &str, paper: Paper) -> String {
    let columns = paper.size.map_or(usize::MAX, |(_, columns)| columns);
    let plain = |letter: char| if letter.is_control() { ' ' } else { letter };
    line.chars().map(plain).take(columns).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use zenav_protocol::messages::{GoalFeedback, GoalPhase};
    use zenav_protocol::time::Stamp;

    use super::*;

    fn node(uid: u32, parent: Option<u32>, name: &str, status: &str, last: &str) -> NodeStatus {
        NodeStatus {
            uid,
            parent,
            name: name.into(),
            id: name.into(),
            status: status.into(),
            feedback: String::new(),
            last: last.into(),
            ports: BTreeMap::new(),
        }
    }

    fn status(goal: Option<&str>, nodes: Vec<NodeStatus>) -> MissionStatus {
        MissionStatus {
            stamp: Stamp(0),
            holder: "m".into(),
            leads: true,
            epoch: 2,
            goal_id: goal.map(str::to_owned),
            tree: goal.map(|_| "T".to_owned()),
            nodes,
            feedback: GoalFeedback::default(),
            queued: 0,
            standbys: Vec::new(),
        }
    }

    fn goal(id: &str, state: GoalPhase) -> GoalState {
        serde_json::from_value(serde_json::json!({
            "id": id, "robot": "r", "state": state, "accepted": 0, "reason": "blocked", "request": { "place": "sink" }
        }))
        .unwrap()
    }

    fn rows(watched: &Watched, paper: Paper) -> Vec<String> {
        watched.picture(paper).lines().skip(1).map(str::to_owned).collect()
    }

    fn of_size(rows: usize, columns: usize) -> Paper {
        Paper {
            size: Some((rows, columns)),
            ..Paper::ENDLESS
        }
    }

    #[test]
    fn a_mission_is_drawn_by_depth() {
        let nodes = vec![
            node(1, None, "Sequence", "RUNNING", "RUNNING"),
            node(2, Some(1), "Wait", "SUCCESS", "SUCCESS"),
            node(3, Some(1), "Drive\n", "RUNNING", "RUNNING"),
        ];
        let watched = Watched::new(status(Some("g"), nodes));
        assert_eq!(
            rows(&watched, of_size(6, 80)),
            [
                "tree T: g, 0 waiting",
                "▶ Sequence",
                "  ▶ Drive ",
                "… 1 more on a taller terminal"
            ]
        );
        assert_eq!(
            rows(&watched, Paper::ENDLESS)[1..],
            ["▶ Sequence", "  ✓ Wait", "  ▶ Drive "]
        );
        assert_eq!(rows(&watched, of_size(20, 7))[1..], ["▶ Seque", "  ✓ Wai", "  ▶ Dri"]);
    }

    #[test]
    fn a_node_that_its_parent_has_reset_keeps_its_last_result() {
        let nodes = vec![
            node(1, None, "Look", "IDLE", "SUCCESS"),
            node(2, None, "Drive", "IDLE", "FAILURE"),
            node(3, None, "Halted", "IDLE", "RUNNING"),
            node(4, None, "New", "IDLE", ""),
        ];
        let watched = Watched::new(status(Some("g"), nodes));
        assert_eq!(
            rows(&watched, Paper::ENDLESS)[1..],
            ["✓ Look", "✗ Drive", "· Halted", "· New"]
        );
        let colored = Paper {
            colors: true,
            ..Paper::ENDLESS
        };
        assert_eq!(rows(&watched, colored)[1], "\x1b[90m✓\x1b[0m Look");
    }

    #[test]
    fn the_tree_stays_with_its_results_after_the_goal_s_end() {
        let nodes = || vec![node(1, None, "Drive", "RUNNING", "RUNNING")];
        let mut watched = Watched::new(status(Some("g"), nodes()));
        watched.end(goal("other", GoalPhase::Succeeded));
        watched.end(goal("g", GoalPhase::Active));
        watched.hear(status(None, Vec::new()));
        assert_eq!(
            rows(&watched, Paper::ENDLESS),
            ["tree T: g has ended, 0 waiting", "▶ Drive"]
        );
        watched.end(goal("g", GoalPhase::Aborted));
        let ended = ["tree T: g Aborted: blocked, 0 waiting", "✗ Drive"];
        assert_eq!(rows(&watched, Paper::ENDLESS), ended);
        // A status from before the end that arrives after it.
        watched.hear(status(Some("g"), nodes()));
        assert_eq!(rows(&watched, Paper::ENDLESS), ended);
        watched.hear(status(Some("h"), nodes()));
        assert_eq!(rows(&watched, Paper::ENDLESS), ["tree T: h, 0 waiting", "▶ Drive"]);
    }

    #[test]
    fn a_silent_mission_is_told_with_its_age_and_in_faint_letters() {
        let mut watched = Watched::new(status(Some("g"), vec![node(1, None, "Drive", "RUNNING", "RUNNING")]));
        let paper = Paper {
            colors: true,
            size: None,
            has_ages: true,
        };
        let fresh = watched.picture(paper);
        assert!(fresh.starts_with("no pose yet, mission 0.0 s old  m leads"), "{fresh}");
        watched.heard.mission = Instant::now().checked_sub(Duration::from_secs(61));
        let silent = watched.picture(paper);
        assert!(
            silent.starts_with("\x1b[2mno pose yet, mission 61 s old  m leads"),
            "{silent}"
        );
        assert!(silent.lines().all(|line| line.starts_with("\x1b[2m")), "{silent}");
    }
}
