//! Recorder. Which messages do the parts of a run exchange? It writes them to a record, as one on the bus would.
//!
//! Times are simulated, from the UNIX epoch on: the same run gives the same record, byte for byte.

use std::collections::BTreeMap;
use std::path::Path;

use zenav_edge::{Outbox, Publication};
use zenav_mission::{Effect, Inputs};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Annotations, MapRef, SimClock};
use zenav_protocol::readings::KindReading;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{self, EdgeReply, Topic};

use super::closed_loop::{ClosedLoop, Heard};
use crate::failure::Failure;
use crate::record::{Kind, RecordOptions, RecordWriter, Sample, TITLE_ENTRY, Written};

/// Writes the record of a run.
pub(crate) struct Recorder {
    writer: RecordWriter,
    now: Stamp,
    /// Newest recorded patch of each robot's map.
    maps: BTreeMap<String, MapRef>,
    /// Newest recorded value of each key that mapping writes when it changes.
    values: BTreeMap<String, Vec<u8>>,
    failure: Option<Failure>,
}

impl Recorder {
    /// Begins a record.
    ///
    /// # Errors
    /// The file exists already or cannot be created.
    pub(crate) fn create(file: &Path, title: String) -> Result<Self, Failure> {
        let options = RecordOptions {
            about: [(TITLE_ENTRY.to_owned(), title)].into(),
            ..RecordOptions::default()
        };
        Ok(Self {
            writer: RecordWriter::create(file, options, Stamp::ZERO.0)?,
            now: Stamp::ZERO,
            maps: BTreeMap::new(),
            values: BTreeMap::new(),
            failure: None,
        })
    }

    /// Writes the places and zones of a robot's map, which do not change during a run.
    pub(super) fn annotate(&mut self, robot: &str, annotations: &Annotations) {
        self.put(&topics::ANNOTATIONS, &[robot], annotations);
    }

    /// One control tick of these robots, recorded. A failure ends the record, and is told by [`Self::finish`]; the run goes on.
    pub(super) fn tick(&mut self, stage: &mut ClosedLoop, names: &[Id]) {
        self.now = stage.now() + stage.simulation.tick();
        self.put(&topics::SIM_CLOCK, &[], &SimClock { stamp: self.now });
        stage.tick_heard(|robot, heard| self.hear(names[robot].as_str(), heard));
    }

    /// Writes what a part of this robot says.
    fn hear(&mut self, robot: &str, heard: Heard<'_>) {
        match heard {
            Heard::Robot(outbox) => self.robot(robot, outbox),
            Heard::Mapping(inputs) => self.mapping(robot, inputs),
            Heard::Mission(Effect::Heartbeat(message)) => self.put(&topics::HEARTBEAT, &[robot], message),
            Heard::Mission(Effect::Plan(message)) => self.put(&topics::PLAN, &[robot], message),
            Heard::Mission(Effect::Status(message)) => self.put(&topics::MISSION, &[robot], message),
            Heard::Mission(Effect::Goal(message)) => {
                self.put(&topics::GOAL_STATE, &[robot, message.id.as_str()], message)
            }
            // Requests and their answers are in no record.
            Heard::Mission(Effect::Persist(_) | Effect::Ask(..) | Effect::Reply(..) | Effect::StandBy) => {}
        }
    }

    /// Ends the record.
    ///
    /// # Errors
    /// The record could not be written.
    pub(crate) fn finish(self) -> Result<Written, Failure> {
        match self.failure {
            Some(failure) => Err(failure),
            None => Ok(self.writer.finish(0)?),
        }
    }

    fn robot(&mut self, name: &str, outbox: &Outbox) {
        for (_, reply) in &outbox.replies {
            if let Ok(EdgeReply::Info(info)) = reply {
                let key = topics::EDGE_INFO.key(&[name]);
                self.write(key, Kind::Reply, Encoding::Json, codec::encode(info, Encoding::Json));
            }
        }
        let robot = &[name];
        for publication in &outbox.publications {
            match publication {
                Publication::Scan(None, message) => self.put(&topics::SCAN, robot, message),
                Publication::Scan(Some(lidar), message) => {
                    self.put(&topics::LIDAR_SCAN, &[name, lidar.as_str()], message)
                }
                Publication::Odometry(message) => self.put(&topics::ODOMETRY, robot, message),
                Publication::Imu(message) => self.put(&topics::IMU, robot, message),
                Publication::Sensor(reading) => put_reading(self, robot, reading),
                Publication::Bump(message) => self.put(&topics::BUMP, robot, message),
                Publication::Battery(message) => self.put(&topics::BATTERY, robot, message),
                Publication::Pose(message) => self.put(&topics::POSE, robot, message),
                Publication::State(message) => self.put(&topics::STATE, robot, message),
                Publication::Event(message) => self.put(&topics::EVENT, robot, message),
                Publication::Obstacles(message) => self.put(&topics::OBSTACLES, robot, message),
                Publication::Intent(message) => self.put(&topics::INTENT, robot, message),
                Publication::Yield(message) => self.put(&topics::YIELD, robot, message),
                Publication::Marker(message) => self.put(&topics::MARKER, robot, message),
            }
        }
    }

    /// The mission's inputs stay until its next step, so most of them come twice.
    fn mapping(&mut self, robot: &str, inputs: &Inputs) {
        for patch in &inputs.map_patches {
            let known = self.maps.get(robot);
            if known.is_none_or(|known| known.id != patch.map.id || known.revision < patch.map.revision) {
                self.maps.insert(robot.to_owned(), patch.map.clone());
                self.put(&topics::MAP_PATCH, &[robot], patch);
            }
        }
        self.put_changed(&topics::MAP_INFO, robot, inputs.map_info.as_ref());
        self.put_changed(&topics::MAP_FRAME, robot, inputs.map_frame.as_ref());
        self.put_changed(&topics::LOCALISATION, robot, inputs.localisation.as_ref());
    }

    fn put_changed<T>(&mut self, topic: &Topic<T>, robot: &str, message: Option<&T>) {
        let Some(message) = message else { return };
        let (key, encoded) = (topic.key(&[robot]), topic.encode(message));
        if let Ok(bytes) = &encoded
            && self.values.insert(key.clone(), bytes.clone()).as_ref() == Some(bytes)
        {
            return;
        }
        self.write(key, Kind::Put, topic.encoding, encoded);
    }

    fn put<T>(&mut self, topic: &Topic<T>, chunks: &[&str], message: &T) {
        let encoded = topic.encode(message);
        self.write(topic.key(chunks), Kind::Put, topic.encoding, encoded);
    }

    fn write(&mut self, key: String, kind: Kind, encoding: Encoding, encoded: Result<Vec<u8>, codec::CodecError>) {
        if self.failure.is_some() {
            return;
        }
        let written = encoded.map_err(Failure::failed).and_then(|bytes| {
            let sample = Sample {
                published: (kind == Kind::Put).then_some(self.now.0),
                ..Sample::new(key, kind, encoding, bytes, self.now.0)
            };
            Ok(self.writer.write(&sample)?)
        });
        self.failure = written.err();
    }
}

macro_rules! reading {
    ([] $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        fn put_reading(recorder: &mut Recorder, robot: &[&str], reading: &KindReading) {
            match reading {
                $(KindReading::$Reading(message) => recorder.put(&topics::$TOPIC, robot, message),)*
            }
        }
    };
}

zenav_protocol::sensor_kinds!(reading []);

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_cloud::mapping::PoseSource;
    use zenav_protocol::messages::GoalPhase;
    use zenav_protocol::robot;
    use zenav_sim::World;

    use super::*;
    use crate::components;
    use crate::config::Layers;
    use crate::lockstep::{Entrant, RunOutcome, Scenario};
    use crate::record::{RecordReader, write_report};

    /// A drive that takes some seconds.
    fn drive(world: &World) -> Scenario<'_> {
        let entrant = Entrant {
            robot: Some("tiago"),
            start: None,
            goal: Point2::new(0.88, 0.09),
        };
        Scenario::of(world, vec![entrant], 60.0)
    }

    #[test]
    fn a_run_is_recorded_byte_for_byte_alike_and_as_one_on_the_bus() {
        let world = World::shipped("kitchen").unwrap();
        let scenario = drive(&world);
        let layers = Layers::load(None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let files = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
        let ends = [None, Some(&files[0]), Some(&files[1])].map(|file| {
            let mut recorder = file.map(|file| Recorder::create(file, "a run".to_owned()).unwrap());
            let reports = scenario.prepare(&layers).unwrap().run(recorder.as_mut(), |_, _, _| {});
            assert_eq!(reports[0].outcome, RunOutcome::Reached);
            if let Some(recorder) = recorder {
                assert!(recorder.finish().unwrap().messages > 0);
            }
            (reports[0].time_s, reports[0].length_m)
        });
        assert!(ends.iter().all(|end| *end == ends[0]), "{ends:?}");
        let [a, b] = files.each_ref().map(|file| std::fs::read(file).unwrap());
        assert!(a == b, "{} and {} bytes", a.len(), b.len());

        let mut counts: BTreeMap<String, u64> = BTreeMap::new();
        let mut revision = 0;
        let (mut drawn, mut goal) = (Vec::new(), None);
        let mut reader = RecordReader::open(&files[0]).unwrap();
        reader.check_messages().unwrap();
        while let Some(sample) = reader.next_sample().unwrap() {
            *counts.entry(sample.key.clone()).or_default() += 1;
            if let Some((_, patch)) = sample.message(&topics::MAP_PATCH) {
                assert_eq!(patch.map.revision, revision + 1, "each patch is written once");
                revision = patch.map.revision;
            }
            if let Some((_, state)) = sample.message(&topics::GOAL_STATE) {
                goal = Some(state.state);
            }
            if let Some((_, annotations)) = sample.message(&topics::ANNOTATIONS) {
                drawn.push(annotations.places);
            }
        }
        for key in [
            "zenav/sim/clock",
            "zenav/robot/edge/scan",
            "zenav/robot/edge/pose",
            "zenav/robot/edge/state",
            "zenav/robot/ask/edge/info",
            "zenav/robot/cloud/map",
            "zenav/robot/cloud/plan",
            "zenav/robot/cloud/mission",
            "zenav/robot/cloud/goal/run",
        ] {
            assert!(counts.contains_key(key), "{key}: {counts:?}");
        }
        assert!(revision > 1, "{counts:?}");
        assert_eq!(drawn, [components::places(&world)]);
        // The run is over when the robot is there; the record has the mission's word on it, too.
        assert_eq!(goal, Some(GoalPhase::Succeeded));
        write_report(&files[0], &folder.path().join("report.html")).unwrap();
        assert!(Recorder::create(&files[0], String::new()).is_err(), "it exists");
    }

    /// Drives and records it: end, time and way of the run, and how many messages the record has on each key.
    fn recorded(scenario: &Scenario<'_>) -> ((RunOutcome, f64, f64), BTreeMap<String, u64>) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.mcap");
        let mut recorder = Recorder::create(&file, "a run".to_owned()).unwrap();
        let prepared = scenario.prepare(&Layers::load(None).unwrap()).unwrap();
        let reports = prepared.run(Some(&mut recorder), |_, _, _| {});
        recorder.finish().unwrap();
        let mut counts: BTreeMap<String, u64> = BTreeMap::new();
        let mut reader = RecordReader::open(&file).unwrap();
        while let Some(sample) = reader.next_sample().unwrap() {
            *counts.entry(sample.key).or_default() += 1;
        }
        ((reports[0].outcome, reports[0].time_s, reports[0].length_m), counts)
    }

    #[test]
    fn a_robot_without_a_plain_lidar_is_localised_and_recorded_by_its_first_named_one() {
        let world = World::shipped("kitchen").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("front.toml");
        let text = robot::shipped("tiago").unwrap().replace("[lidar]", "[lidars.front]");
        std::fs::write(&file, text).unwrap();
        let front = format!("{}+indoor", file.display());
        for (poses, timeout) in [(PoseSource::Slam, 60.0), (PoseSource::Localise, 2.0)] {
            let [plain, named] = ["tiago+indoor", front.as_str()].map(|robot| {
                let mut scenario = drive(&world);
                scenario.entrants[0].robot = Some(robot);
                let known_map = poses == PoseSource::Localise;
                recorded(&Scenario {
                    known_map,
                    poses: Some(poses),
                    timeout,
                    ..scenario
                })
            });
            assert_eq!(named, plain, "{poses:?}");
            let (end, counts) = named;
            assert_eq!(end.0 == RunOutcome::Reached, poses == PoseSource::Slam, "{end:?}");
            for key in ["zenav/robot/edge/scan", "zenav/robot/cloud/localisation"] {
                assert!(counts.contains_key(key), "{key}: {counts:?}");
            }
            assert!(!counts.contains_key("zenav/robot/edge/scan/front"), "{counts:?}");
        }
    }

    #[test]
    fn scans_of_a_further_lidar_are_recorded_under_its_name() {
        let world = World::shipped("kitchen").unwrap();
        let mut scenario = drive(&world);
        scenario.entrants[0].robot = Some("tiago+rear_lidar");
        scenario.timeout = 1.0;
        let (_, counts) = recorded(&scenario);
        for key in ["zenav/robot/edge/scan", "zenav/robot/edge/scan/rear"] {
            assert!(counts.contains_key(key), "{key}: {counts:?}");
        }
        assert!(!counts.contains_key("zenav/robot/edge/scan/lidar"), "{counts:?}");
    }

    #[test]
    fn a_full_disk_ends_the_record_and_not_the_run() {
        let world = World::shipped("kitchen").unwrap();
        let scenario = Scenario {
            timeout: 1.0,
            ..drive(&world)
        };
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(&folder.path().join("a.mcap"), String::new()).unwrap();
        recorder.failure = Some(Failure::failed("no space left on device"));
        let prepared = scenario.prepare(&Layers::load(None).unwrap()).unwrap();
        let reports = prepared.run(Some(&mut recorder), |_, _, _| {});
        assert_eq!(reports[0].outcome, RunOutcome::Timeout);
        let failure = recorder.finish().unwrap_err();
        assert!(failure.message.contains("no space left"), "{failure}");
    }
}
