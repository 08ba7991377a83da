//! Recomputed motion. Checks that motion workers give the recorded answers to the recorded requests, byte for byte.
//!
//! The state that a worker keeps between requests (earlier paths, and the bounds on how long they stay valid) is rebuilt by sending a new
//! worker the same requests in the same order, on the same map revisions. Requests are numbered: if one is missing, or was cut short by
//! its time limit, the worker's state from then on is unknown. Answers that match still count as the same; for the others the reason is
//! given why they cannot be compared. Durations of phases are excluded from the comparison.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use zenav_cloud::motion::worker::{Cancel, MotionWorker};
use zenav_cloud::motion::{MotionSettings, padding};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{
    MapPatch, MapRef, MapReply, MotionRecord, MotionReply, PlanOrigin, PlanReply, Refusal, SmoothReply,
};
use zenav_protocol::topics;
use zenav_space::Zones;

use super::settings::RunSettings;
use crate::failure::Failure;
use crate::record::format::Sample;
use crate::record::reader::RecordReader;

/// How the recomputed answers of a motion worker compare with the recorded ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MotionVerdict {
    /// Name of the worker.
    pub worker: String,
    /// Whether all comparable answers equal the recorded ones, byte for byte, and there is at least one.
    pub identical: bool,
    /// Requests in the record.
    pub requests: u64,
    /// Requests whose answers came out the same.
    pub same: u64,
    /// Of these, those answered from the worker's kept state.
    pub kept: u64,
    /// Requests whose answers came out different.
    pub different: u64,
    /// The first difference.
    pub difference: Option<String>,
    /// Requests whose answers cannot be compared.
    pub uncompared: Vec<Uncompared>,
}

/// A request whose answer cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Uncompared {
    /// Number of the worker's request.
    pub number: u64,
    /// Reason.
    pub why: String,
}

impl MotionVerdict {
    pub(super) fn lines(&self) -> String {
        let verdict = match &self.difference {
            Some(why) => format!("different: {why}"),
            None if self.same > 0 => "identical, byte for byte".to_owned(),
            None => "not compared".to_owned(),
        };
        let mut lines = vec![format!(
            "{}: answers {verdict} ({} of {} the same, {} of them from what it had kept)",
            self.worker, self.same, self.requests, self.kept
        )];
        let told =
            |uncompared: &Uncompared| format!("  request {} not compared: {}", uncompared.number, uncompared.why);
        lines.extend(self.uncompared.iter().map(told));
        lines.join("\n")
    }
}

/// Answers all recorded requests again.
pub(super) fn recompute(file: &Path, settings: &mut RunSettings) -> Result<Vec<MotionVerdict>, Failure> {
    // Read before the requests: a worker may have had a patch earlier than the recorder.
    let changes = changes(file)?;
    let mut workers = BTreeMap::<String, Rerun<'_>>::new();
    let mut reader = RecordReader::open(file)?;
    while let Some(sample) = reader.next_sample()? {
        if let Some((_, record)) = sample.message(&topics::MOTION) {
            let rerun = workers
                .entry(record.worker.clone())
                .or_insert_with(|| Rerun::new(&record.worker, settings.motion(&record.worker), &changes));
            rerun.see(record);
        }
    }
    Ok(workers.into_values().map(Rerun::end).collect())
}

/// Map changes of each robot.
type Changes = BTreeMap<String, Vec<Change>>;

enum Change {
    Patch(MapPatch),
    Whole(Box<MapReply>),
}

impl Change {
    /// The revision that it leads to.
    fn map(&self) -> &MapRef {
        match self {
            Self::Patch(patch) => &patch.map,
            Self::Whole(whole) => &whole.info.map,
        }
    }
}

fn changes(file: &Path) -> Result<Changes, Failure> {
    let mut changes = Changes::new();
    let mut reader = RecordReader::open(file)?;
    while let Some(sample) = reader.next_sample()? {
        if let Some((robot, change)) = change(&sample) {
            changes.entry(robot).or_default().push(change);
        }
    }
    Ok(changes)
}

fn change(sample: &Sample) -> Option<(String, Change)> {
    if let Some((robot, reply)) = sample.reply(&topics::MAP) {
        return Some((robot, Change::Whole(Box::new(reply))));
    }
    let (robot, patch) = sample.message(&topics::MAP_PATCH)?;
    Some((robot, Change::Patch(patch)))
}

/// A worker's copy of a robot's map, at the revision of its last request.
#[derive(Clone, Default)]
struct Copy {
    replica: MapReplica,
    /// Number of map changes already applied.
    taken: usize,
}

impl Copy {
    /// Advances to a later revision. If the record does not lead there, the copy stays as it is and the result is `false`: a request from
    /// before the record must not take the changes of those that follow.
    fn follow(&mut self, changes: &[Change], wanted: &MapRef) -> bool {
        if self.replica.map() == wanted {
            return true;
        }
        let left = changes.get(self.taken..).unwrap_or_default();
        let Some(last) = left.iter().rposition(|change| change.map() == wanted) else {
            return false;
        };
        let mut ahead = self.clone();
        for change in left.iter().take(last + 1) {
            ahead.take(change);
            if ahead.replica.map() == wanted {
                *self = ahead;
                return true;
            }
        }
        false
    }

    fn take(&mut self, change: &Change) {
        match change {
            Change::Patch(patch) => {
                let _ = self.replica.apply(patch);
            }
            Change::Whole(whole) if !self.replica.holds(&whole.info.map) => {
                self.replica.replace(whole);
            }
            Change::Whole(_) => {}
        }
        self.taken += 1;
    }
}

/// A worker that receives the requests of a recorded one.
struct Rerun<'a> {
    settings: MotionSettings,
    changes: &'a Changes,
    worker: MotionWorker,
    maps: BTreeMap<String, Copy>,
    zones: BTreeMap<String, Arc<Zones>>,
    /// Number of the last request.
    number: u64,
    /// Why the recorded worker's state may differ.
    doubt: Option<String>,
    verdict: MotionVerdict,
}

impl<'a> Rerun<'a> {
    fn new(worker: &str, settings: MotionSettings, changes: &'a Changes) -> Self {
        Self {
            changes,
            worker: MotionWorker::new(Arc::default(), settings.clone()),
            settings,
            maps: BTreeMap::new(),
            zones: BTreeMap::new(),
            number: 0,
            doubt: None,
            verdict: MotionVerdict {
                worker: worker.to_owned(),
                ..MotionVerdict::default()
            },
        }
    }

    fn see(&mut self, record: MotionRecord) {
        self.verdict.requests += 1;
        if record.number == 1 && self.number > 0 {
            // The worker was restarted.
            let before = std::mem::take(&mut self.verdict);
            *self = Self {
                verdict: before,
                ..Self::new("", self.settings.clone(), self.changes)
            };
        }
        if record.number != self.number + 1 {
            let missing = format!("requests {} to {}", self.number + 1, record.number.saturating_sub(1));
            self.doubt.get_or_insert(format!(
                "{missing} of the worker are not in the record, and what it kept of them is not known"
            ));
        }
        self.number = record.number;
        match self.answer(&record) {
            Ok(made) => self.compare(&record, made),
            Err(why) => {
                self.doubt
                    .get_or_insert(format!("request {} could not be asked again", record.number));
                self.leave_out(why);
            }
        }
        if record.cut_short {
            self.doubt.get_or_insert(format!(
                "request {} ran out of time, and what the worker kept of it is not known",
                record.number
            ));
        }
    }

    /// The answer to a request, on the map revision it was answered on.
    fn answer(&mut self, record: &MotionRecord) -> Result<Result<MotionReply, Refusal>, String> {
        let robot = record.request.map().0;
        let zones = Zones::new(&record.zones).map_err(|error| error.to_string())?;
        let known = self.zones.entry(robot.to_owned()).or_default();
        // Kept while equal: the configuration spaces built with the zones stay valid too.
        if **known != zones {
            *known = Arc::new(zones);
        }
        self.worker.set_zones(Arc::clone(known));
        let map = match &record.map {
            None => None,
            Some(wanted) => {
                let copy = self.maps.entry(robot.to_owned()).or_default();
                let changes = self.changes.get(robot).map_or(&[][..], Vec::as_slice);
                if !copy.follow(changes, wanted) {
                    return Err(format!("revision {} of its map is not in the record", wanted.revision));
                }
                if let Some(extent) = padding(&record.request) {
                    copy.replica.reach(&extent);
                }
                Some(copy.replica.clone())
            }
        };
        let never = Cancel::default();
        Ok(self.worker.answer(map.as_ref(), &record.request, &mut || 0.0, &never))
    }

    fn compare(&mut self, record: &MotionRecord, mut made: Result<MotionReply, Refusal>) {
        let mut recorded = record.answer.clone();
        for answer in [&mut made, &mut recorded].into_iter().flatten() {
            without_times(answer);
        }
        if let (Ok(made), Ok(recorded)) = (&mut made, &recorded) {
            without_new_corridor(made, recorded);
        }
        let bytes = |answer| codec::encode(answer, Encoding::Cbor).ok();
        if bytes(&made).is_some_and(|made| Some(made) == bytes(&recorded)) {
            self.verdict.same += 1;
            self.verdict.kept += u64::from(recorded.as_ref().is_ok_and(is_kept));
        } else if record.cut_short {
            self.leave_out("its time ran out while it was worked on".to_owned());
        } else if let Some(doubt) = self.doubt.clone() {
            self.leave_out(doubt);
        } else {
            self.verdict.different += 1;
            let why = difference(&recorded, &made);
            self.verdict
                .difference
                .get_or_insert(format!("request {}: {why}", record.number));
        }
    }

    fn leave_out(&mut self, why: String) {
        let number = self.number;
        self.verdict.uncompared.push(Uncompared { number, why });
    }

    fn end(mut self) -> MotionVerdict {
        self.verdict.identical = self.verdict.different == 0 && self.verdict.same > 0;
        self.verdict
    }
}

/// The path and the trajectory of an answer.
fn parts(answer: &MotionReply) -> (Option<&PlanReply>, Option<&SmoothReply>) {
    match answer {
        MotionReply::Plan(plan) => (Some(plan), None),
        MotionReply::Smooth(smooth) => (None, Some(smooth)),
        MotionReply::Trajectory(both) => (Some(&both.plan), both.smooth.as_ref()),
    }
}

fn is_kept(answer: &MotionReply) -> bool {
    parts(answer).0.is_some_and(|plan| plan.origin != PlanOrigin::Searched)
}

/// As [`parts`].
fn parts_mut(answer: &mut MotionReply) -> (Option<&mut PlanReply>, Option<&mut SmoothReply>) {
    match answer {
        MotionReply::Plan(plan) => (Some(plan), None),
        MotionReply::Smooth(smooth) => (None, Some(smooth)),
        MotionReply::Trajectory(both) => (Some(&mut both.plan), both.smooth.as_mut()),
    }
}

/// Removes the corridor from an answer if the recorded one has none: older workers did not tell it.
fn without_new_corridor(answer: &mut MotionReply, recorded: &MotionReply) {
    if let (Some(smooth), Some(SmoothReply { corridor, .. })) = (parts_mut(answer).1, parts(recorded).1)
        && corridor.is_empty()
    {
        smooth.corridor.clear();
    }
}

/// Removes the durations of phases from an answer.
fn without_times(answer: &mut MotionReply) {
    let (plan, smooth) = parts_mut(answer);
    if let Some(plan) = plan {
        plan.search_ms = 0.0;
    }
    if let Some(SmoothReply { statistics, .. }) = smooth {
        (statistics.search_ms, statistics.corridor_ms) = (0.0, 0.0);
        (statistics.geometry_ms, statistics.timing_ms) = (0.0, 0.0);
    }
}

/// How an answer differs from the recorded one.
fn difference(recorded: &Result<MotionReply, Refusal>, made: &Result<MotionReply, Refusal>) -> String {
    let (recorded, made) = match (recorded, made) {
        (Ok(recorded), Ok(made)) => (recorded, made),
        (Err(recorded), Ok(_)) => return format!("answered, recorded a refusal: {recorded}"),
        (Ok(_), Err(made)) => return format!("refused, recorded an answer: {made}"),
        (Err(recorded), Err(made)) => return format!("refused ({made}), recorded ({recorded})"),
    };
    let ((was_plan, was_smooth), (plan, smooth)) = (parts(recorded), parts(made));
    if was_plan.map(|plan| &plan.outcome) != plan.map(|plan| &plan.outcome) {
        return "another path".to_owned();
    }
    let (Some(was), Some(now)) = (was_smooth, smooth) else {
        return "the same path otherwise found".to_owned();
    };
    let (was, now) = (&was.trajectory, &now.trajectory);
    match was.iter().zip(now.iter()).position(|(was, now)| was != now) {
        Some(nth) => format!("the trajectory differs from its sample {nth} of {} on", was.len()),
        None if was.len() != now.len() => format!("{} samples, recorded {}", now.len(), was.len()),
        None => "the same trajectory, other statistics or corridor".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_protocol::grid::Occupancy;
    use zenav_protocol::messages::{
        DrivingProfile, MapInfo, MotionRequest, PlanOutcome, TILE, Tile, TrajectoryRequest,
    };
    use zenav_protocol::time::Stamp;

    use super::*;
    use crate::record::format::Kind;
    use crate::record::made_up;

    fn map(revision: u64) -> MapRef {
        MapRef::new("hall", revision)
    }

    /// A hall of 6.4 m by 3.2 m with a wall across it and a door in the wall, at revision 3.
    fn whole() -> MapReply {
        let spec = zenav_fixtures::spec(2 * TILE, TILE, 0.05);
        let wall: Vec<_> = (0..40).map(|y| (60, y)).collect();
        MapReply {
            info: MapInfo {
                stamp: Stamp::ZERO,
                map: map(3),
                spec,
                free: 0,
                occupied: 0,
                unknown: 0,
                scans: 0,
                stored: false,
            },
            values: zenav_fixtures::map_with_occupied(spec, &wall).into_values(),
            trajectory: Vec::new(),
            stored: Vec::new(),
        }
    }

    /// An obstacle appears in the right half.
    fn patch() -> MapPatch {
        let mut values = vec![Occupancy::FREE; (TILE * TILE) as usize];
        for row in 18..30 {
            values[row * TILE as usize + 28] = Occupancy::OCCUPIED;
        }
        MapPatch {
            stamp: Stamp::ZERO,
            map: map(4),
            base_revision: 3,
            spec: whole().info.spec,
            tiles: vec![Tile { x: 1, y: 0, values }],
        }
    }

    fn request(x: f64) -> MotionRequest {
        let (start, goal) = (Pose2::new(x, 1.025, 0.0), Pose2::new(5.525, 1.025, 0.0));
        MotionRequest::Trajectory(TrajectoryRequest {
            plan: zenav_fixtures::plan_request("r", map(3), start, goal),
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(0.0),
            profile: DrivingProfile::default(),
        })
    }

    /// A worker's answers to the same goal from several starts; the map changes after the second.
    fn drive() -> Vec<MotionRecord> {
        let mut worker = MotionWorker::new(Arc::default(), MotionSettings::default());
        let mut replica = MapReplica::new();
        assert!(replica.replace(&whole()));
        let mut time = 0.0;
        let mut clock = || {
            time += 0.001;
            time
        };
        (1..)
            .zip([1.025, 1.025, 1.025, 1.525])
            .map(|(number, x)| {
                if number == 3 {
                    let _ = replica.apply(&patch());
                }
                MotionRecord {
                    stamp: Stamp(number),
                    worker: "w".to_owned(),
                    number,
                    map: Some(replica.map().clone()),
                    zones: Vec::new(),
                    request: request(x),
                    answer: worker.answer(Some(&replica), &request(x), &mut clock, &Cancel::default()),
                    cut_short: false,
                }
            })
            .collect()
    }

    /// Verdict on a record of these; without `has_map` the whole map is left out.
    fn verdict(records: &[MotionRecord], has_map: bool) -> MotionVerdict {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.mcap");
        let as_cbor = |key, kind, bytes| Sample::new(key, kind, Encoding::Cbor, bytes, 10);
        // The recorder gets the patch later than the worker did.
        let answers = records
            .iter()
            .map(|record| made_up::sample(&topics::MOTION.key(&["r"]), record, 10));
        let map = has_map.then(|| {
            let bytes = codec::encode(&whole(), Encoding::Cbor).unwrap();
            as_cbor(topics::MAP.key(&["r"]), Kind::Reply, bytes)
        });
        let bytes = codec::encode(&patch(), Encoding::Cbor).unwrap();
        let patch = as_cbor(topics::MAP_PATCH.key(&["r"]), Kind::Put, bytes);
        made_up::record(&file, answers.chain(map).chain([patch]));
        let mut verdicts = recompute(&file, &mut RunSettings::default()).unwrap();
        assert_eq!(verdicts.len(), 1);
        verdicts.remove(0)
    }

    #[test]
    fn the_same_requests_on_the_same_maps_have_the_same_answers_those_from_what_was_kept_too() {
        let records = drive();
        let verdict = verdict(&records, true);
        assert!(verdict.identical, "{verdict:?}");
        assert_eq!((verdict.requests, verdict.same), (4, 4), "{verdict:?}");
        assert!(verdict.kept > 0, "{verdict:?}");
        assert!(verdict.uncompared.is_empty(), "{verdict:?}");
    }

    #[test]
    fn a_record_of_workers_that_told_no_corridor_has_the_same_answers() {
        let mut records = drive();
        let mut corridors = 0;
        for record in &mut records {
            if let Ok(MotionReply::Trajectory(both)) = &mut record.answer
                && let Some(smooth) = &mut both.smooth
            {
                corridors += std::mem::take(&mut smooth.corridor).len();
            }
        }
        assert!(corridors > 0, "the answers of now have some");
        let verdict = verdict(&records, true);
        assert!(verdict.identical && verdict.same == 4, "{verdict:?}");
    }

    #[test]
    fn an_answer_that_comes_out_otherwise_is_named_with_what_differs() {
        let mut records = drive();
        let Ok(MotionReply::Trajectory(both)) = &mut records[2].answer else {
            panic!("no path")
        };
        let smooth = both.smooth.as_mut().unwrap();
        let mut points = smooth.trajectory.to_vec();
        points[7].x += 1e-12;
        smooth.trajectory = points.into();
        let other = verdict(&records, true);
        assert!(!other.identical && other.same == 3, "{other:?}");
        let why = other.difference.unwrap();
        assert!(
            why.starts_with("request 3: the trajectory differs from its sample 7 "),
            "{why}"
        );

        let Ok(MotionReply::Trajectory(both)) = &mut records[0].answer else {
            panic!("no path")
        };
        both.plan.outcome = PlanOutcome::NoPath;
        let why = verdict(&records, true).difference.unwrap();
        assert_eq!(why, "request 1: another path");
    }

    #[test]
    fn a_request_from_before_the_record_leaves_the_maps_to_those_that_follow() {
        // A recorder that joins a running worker gets its last answers too, but not the maps they were made on.
        let old = drive()
            .into_iter()
            .take(2)
            .zip(1_u64..)
            .map(|(record, revision)| MotionRecord {
                map: Some(map(revision)),
                answer: Err(Refusal::bad_request("something else")),
                ..record
            });
        let new = drive().into_iter().map(|record| MotionRecord {
            number: record.number + 2,
            ..record
        });
        let verdict = verdict(&old.chain(new).collect::<Vec<_>>(), true);
        assert!(verdict.identical, "{verdict:?}");
        assert_eq!((verdict.requests, verdict.same), (6, 4), "{verdict:?}");
        let why: Vec<&str> = verdict.uncompared.iter().map(|one| one.why.as_str()).collect();
        assert!(
            why.len() == 2 && why[0].starts_with("revision 1 ") && why[1].starts_with("revision 2 "),
            "{why:?}"
        );
    }

    #[test]
    fn what_the_record_does_not_hold_is_no_difference() {
        let records = drive();
        let late = verdict(&records[1..], true);
        assert!(late.difference.is_none(), "{late:?}");
        assert_eq!(late.same + late.uncompared.len() as u64, 3, "{late:?}");
        assert!(
            late.uncompared
                .iter()
                .any(|one| one.why.starts_with("requests 1 to 1 ")),
            "an answer from what was kept: {late:?}"
        );

        let without_map = verdict(&records, false);
        assert!(!without_map.identical && without_map.same == 0, "{without_map:?}");
        assert!(without_map.uncompared[0].why.contains("revision 3"), "{without_map:?}");

        let mut hurried = records;
        hurried[2].cut_short = true;
        hurried[2].answer = Err(Refusal::bad_request("something else"));
        let hurried = verdict(&hurried, true);
        assert!(hurried.difference.is_none(), "{hurried:?}");
        assert!(hurried.uncompared[0].why.contains("ran out"), "{hurried:?}");
    }
}
