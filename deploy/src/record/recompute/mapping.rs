//! Recomputed maps. Checks that mapping makes the recorded map from the recorded scans, byte for byte.
//!
//! Two inputs of mapping are on no key: which scans it skipped, as it keeps only the newest of those queued, and when it learnt the
//! robot's footprint. Both are searched for: if some choice of them reproduces a patch to the last byte, the patch counts as the same.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use zenav_cloud::mapping::MappingCore;
use zenav_mapping::Mapper;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{MapPatch, MapRef, Scan};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;

use super::settings::RunSettings;
use crate::failure::Failure;
use crate::record::format::Sample;
use crate::record::reader::RecordReader;

/// Patches queued for the description with their number of scans.
const WAITING: usize = 4;
/// Most histories of one map followed in parallel.
const HISTORIES: usize = 8;
/// Most selections of scans tried for one patch.
const CHOICES: usize = 128;
/// What to do about a map whose beginning is not in the record.
const CURE: &str = "start the recorder before mapping, as `zenav demo --record` does";

/// How a recomputed map compares with the recorded one.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MapVerdict {
    /// Name of the robot.
    pub robot: String,
    /// Whether every patch equals the recorded one, byte for byte.
    pub identical: bool,
    /// Patches in the record.
    pub patches: u64,
    /// Patches that came out the same.
    pub same_patches: u64,
    /// Scans in the record.
    pub scans: u64,
    /// Scans that mapping skipped.
    pub unseen_scans: u64,
    /// Cells of the last map.
    pub cells: u64,
    /// Cells of it that came out different.
    pub differing_cells: u64,
    /// The first patch that came out different, or why nothing could be compared.
    pub difference: Option<String>,
}

impl MapVerdict {
    pub(super) fn line(&self) -> String {
        let verdict = match &self.difference {
            None => "identical, byte for byte".to_owned(),
            Some(why) if self.cells == 0 => format!("not computed again: {why}"),
            Some(why) => format!(
                "different: {why}; {} of {} cells of the last map differ",
                self.differing_cells, self.cells
            ),
        };
        let unseen = match self.unseen_scans {
            0 => String::new(),
            count => format!(", {count} of them never reached mapping"),
        };
        format!(
            "{}: map {verdict} ({} of {} patches the same; {} scans{unseen})",
            self.robot, self.same_patches, self.patches, self.scans
        )
    }
}

/// Recomputes the maps of all robots.
pub(super) fn recompute(file: &Path, settings: &mut RunSettings) -> Result<Vec<MapVerdict>, Failure> {
    // Read first: the recorder may have asked for footprints later than mapping did.
    let footprints = footprints(file)?;
    let mut reader = RecordReader::open(file)?;
    let mut robots = BTreeMap::<String, MapHistory>::new();
    while let Some(sample) = reader.next_sample()? {
        let mut chunks = sample.key.split('/');
        if let (Some("zenav"), Some(robot)) = (chunks.next(), chunks.next()) {
            if !robots.contains_key(robot) {
                let footprint = footprints.get(robot).cloned();
                robots.insert(robot.to_owned(), MapHistory::new(robot, footprint));
            }
            if let Some(history) = robots.get_mut(robot) {
                history.see(&sample, settings);
            }
        }
    }
    let seen = robots.into_values().filter(|history| history.verdict.patches > 0);
    Ok(seen.map(|history| history.end(settings)).collect())
}

/// Each robot's footprint, from its edge's reply to the recorder.
fn footprints(file: &Path) -> Result<BTreeMap<String, Footprint>, Failure> {
    let mut reader = RecordReader::open(file)?;
    let mut footprints = BTreeMap::new();
    while let Some(sample) = reader.next_sample()? {
        if let Some((robot, info)) = sample.reply(&topics::EDGE_INFO)
            && let Some(model) = info.model
        {
            footprints.insert(robot, model.footprint);
        }
    }
    Ok(footprints)
}

/// A recorded patch.
struct Recorded {
    patch: MapPatch,
    bytes: Vec<u8>,
}

/// A recorded scan.
struct Heard {
    scan: Scan,
    /// Whether it comes from the main lidar, the one used for poses.
    is_main: bool,
    /// The robot's boot at that time.
    boot_id: Arc<str>,
}

/// The map of one robot, recomputed along its record.
struct MapHistory {
    footprint: Option<Footprint>,
    /// Scans not yet in a patch, in order of arrival.
    scans: Vec<Heard>,
    /// The robot's boot and frame, as last reported.
    boot_id: Arc<str>,
    frame: u64,
    patches: VecDeque<Recorded>,
    /// For each described revision: number of scans in the map, and whether it came from a file.
    described: HashMap<MapRef, (u64, bool)>,
    /// Candidate states of mapping, each with whether it knows the footprint.
    mappers: Vec<(MappingCore, bool)>,
    inserted: u64,
    replica: MapReplica,
    verdict: MapVerdict,
}

impl MapHistory {
    fn new(robot: &str, footprint: Option<Footprint>) -> Self {
        Self {
            footprint,
            scans: Vec::new(),
            boot_id: Arc::default(),
            frame: 0,
            patches: VecDeque::new(),
            described: HashMap::new(),
            mappers: Vec::new(),
            inserted: 0,
            replica: MapReplica::new(),
            verdict: MapVerdict {
                robot: robot.to_owned(),
                ..MapVerdict::default()
            },
        }
    }

    fn hear(&mut self, scan: Scan, is_main: bool) {
        self.verdict.scans += 1;
        self.scans.push(Heard {
            scan,
            is_main,
            boot_id: Arc::clone(&self.boot_id),
        });
    }

    fn see(&mut self, sample: &Sample, settings: &mut RunSettings) {
        if let Some((_, scan)) = sample.message(&topics::SCAN) {
            self.hear(scan, true);
        } else if let Some((_, scan)) = sample.message(&topics::LIDAR_SCAN) {
            self.hear(scan, false);
        } else if let Some((_, state)) = sample.message(&topics::STATE) {
            self.frame = state.frame;
            if *self.boot_id != *state.boot_id {
                self.boot_id = state.boot_id.into();
                // Mapping may have known the first boot before the recorder did.
                for heard in self.scans.iter_mut().filter(|heard| heard.boot_id.is_empty()) {
                    heard.boot_id = Arc::clone(&self.boot_id);
                }
            }
        } else if let Some((_, info)) = sample.message(&topics::MAP_INFO) {
            self.described.insert(info.map, (info.scans, info.stored));
        } else if let Some((_, patch)) = sample.message(&topics::MAP_PATCH) {
            self.verdict.patches += 1;
            let bytes = sample.bytes.clone();
            self.patches.push_back(Recorded { patch, bytes });
        }
        // A patch's description comes right after it.
        let is_described = |recorded: &Recorded| self.described.contains_key(&recorded.patch.map);
        if self.patches.len() > WAITING || self.patches.front().is_some_and(is_described) {
            self.step(settings);
        }
    }

    fn end(mut self, settings: &mut RunSettings) -> MapVerdict {
        while !self.patches.is_empty() {
            self.step(settings);
        }
        if let Some((core, _)) = self.mappers.first() {
            let (cells, differing) = compare(self.replica.grid(), &core.mapper.grid());
            (self.verdict.cells, self.verdict.differing_cells) = (cells, differing);
        }
        self.verdict.identical = self.verdict.difference.is_none() && self.verdict.same_patches == self.verdict.patches;
        self.verdict
    }

    fn differ(&mut self, why: String) {
        self.verdict.difference.get_or_insert(why);
    }

    /// Recomputes the next patch.
    fn step(&mut self, settings: &mut RunSettings) {
        let Some(Recorded { patch, bytes }) = self.patches.pop_front() else {
            return;
        };
        let described = self.described.remove(&patch.map);
        // The replica follows the record, whatever mapping was told.
        let _ = self.replica.apply(&patch);
        let is_known = self
            .mappers
            .first()
            .is_some_and(|(core, _)| core.mapper.map().id == patch.map.id);
        if !is_known && let Err(why) = self.begin(&patch, described, settings) {
            self.mappers.clear();
            self.scans.retain(|heard| heard.scan.stamp > patch.stamp);
            self.differ(why);
            return;
        }
        let candidates: Vec<usize> = (0..self.scans.len())
            .filter(|nth| self.scans[*nth].scan.stamp <= patch.stamp)
            .collect();
        let wanted = described.map_or(candidates.len() as u64, |(scans, _)| {
            scans.saturating_sub(self.inserted)
        });
        let wanted = usize::try_from(wanted).unwrap_or(usize::MAX);
        if wanted > candidates.len() {
            self.differ(format!(
                "revision {}: {wanted} scans are in it, the record has {}",
                patch.map.revision,
                candidates.len()
            ));
        }
        let choices = choices(&candidates, wanted.min(candidates.len()));
        let mut explained = Vec::new();
        let mut unexplained = None;
        for chosen in &choices {
            let scans: Vec<&Heard> = chosen.iter().map(|nth| &self.scans[*nth]).collect();
            for (core, knows) in &self.mappers {
                for (mut after, knows) in self.insertions(core, *knows, &scans) {
                    let made = after.mapper.take_patch();
                    let same = made
                        .as_ref()
                        .is_some_and(|made| codec::encode(made, Encoding::Cbor).is_ok_and(|encoded| encoded == bytes));
                    if same && explained.len() < HISTORIES {
                        explained.push((after, knows, chosen.len()));
                    } else if unexplained.is_none() {
                        unexplained = Some((after, knows, made, chosen.len()));
                    }
                }
            }
            if !explained.is_empty() {
                break;
            }
        }
        if let Some((_, _, count)) = explained.first() {
            self.verdict.same_patches += 1;
            self.inserted += *count as u64;
            self.verdict.unseen_scans += (candidates.len() - count) as u64;
            self.mappers = explained.into_iter().map(|(core, knows, _)| (core, knows)).collect();
        } else if let Some((core, knows, made, count)) = unexplained {
            let how = difference(&patch, made.as_ref());
            self.differ(format!("revision {}: {how}", patch.map.revision));
            self.inserted += count as u64;
            self.mappers = vec![(core, knows)];
        }
        self.scans.retain(|heard| heard.scan.stamp > patch.stamp);
    }

    /// Starts a map at its first patch.
    fn begin(
        &mut self,
        patch: &MapPatch,
        described: Option<(u64, bool)>,
        settings: &mut RunSettings,
    ) -> Result<(), String> {
        if patch.base_revision != 0 {
            return Err(format!(
                "the record begins at revision {} of the map, whose beginning is not in it ({CURE})",
                patch.map.revision
            ));
        }
        if described.is_some_and(|(_, stored)| stored) {
            return Err("the map was loaded from a file, which is not in the record".to_owned());
        }
        if self.scans.iter().all(|heard| heard.scan.stamp > patch.stamp) {
            return Err(format!(
                "the record began later than the map: the scans of its beginning are not in it ({CURE})"
            ));
        }
        let (mapping, poses) = settings.mapping(&self.verdict.robot);
        let mut core = MappingCore::new(Mapper::new(mapping, patch.map.id.clone()), &poses);
        core.hear_frame(self.frame);
        self.inserted = 0;
        self.mappers = vec![(core.clone(), false)];
        if let Some(footprint) = &self.footprint {
            core.mapper.set_footprint(footprint.clone());
            self.mappers.insert(0, (core, true));
        }
        Ok(())
    }

    /// States of mapping after these scans: with the footprint already known, never learnt, or learnt before any one of them.
    fn insertions(&self, core: &MappingCore, knows: bool, scans: &[&Heard]) -> Vec<(MappingCore, bool)> {
        let learns = match &self.footprint {
            Some(footprint) if !knows => (0..scans.len()).map(|nth| Some((nth, footprint))).collect(),
            _ => Vec::new(),
        };
        let ways = std::iter::once(None).chain(learns);
        ways.map(|way| {
            let mut after = core.clone();
            for (nth, heard) in scans.iter().enumerate() {
                if let Some((_, footprint)) = way.filter(|(learnt, _)| *learnt == nth) {
                    after.mapper.set_footprint(footprint.clone());
                }
                if heard.is_main {
                    after.insert(&heard.scan, &heard.boot_id);
                } else {
                    after.insert_further(&heard.scan, &heard.boot_id);
                }
            }
            (after, knows || way.is_some())
        })
        .collect()
    }
}

/// Selections of scans that may have been inserted, likeliest first: all but the oldest ones, as if mapping had started later than the
/// record, then every other selection, up to a limit.
fn choices(candidates: &[usize], wanted: usize) -> Vec<Vec<usize>> {
    fn more(candidates: &[usize], wanted: usize, chosen: &mut Vec<usize>, found: &mut Vec<Vec<usize>>) {
        if found.len() >= CHOICES {
            return;
        }
        if chosen.len() == wanted {
            found.push(chosen.clone());
            return;
        }
        let missing = wanted - chosen.len();
        for (nth, candidate) in candidates.iter().enumerate().rev() {
            if nth + 1 < missing {
                break;
            }
            chosen.push(*candidate);
            more(&candidates[..nth], wanted, chosen, found);
            chosen.pop();
        }
    }
    let mut found = Vec::new();
    more(candidates, wanted, &mut Vec::new(), &mut found);
    // Selected from the newest backwards, inserted in order of arrival.
    for choice in &mut found {
        choice.reverse();
    }
    found
}

/// How a recomputed patch differs from the recorded one.
fn difference(recorded: &MapPatch, made: Option<&MapPatch>) -> String {
    let Some(made) = made else {
        return "nothing has changed in the recomputed map".to_owned();
    };
    if made.spec != recorded.spec {
        return format!(
            "{}x{} cells, recorded {}x{}",
            made.spec.width, made.spec.height, recorded.spec.width, recorded.spec.height
        );
    }
    if made.stamp != recorded.stamp || made.map != recorded.map || made.base_revision != recorded.base_revision {
        return format!(
            "revision {} at {:.3} s, recorded {} at {:.3} s",
            made.map.revision,
            made.stamp.as_secs(),
            recorded.map.revision,
            recorded.stamp.as_secs()
        );
    }
    let places = |patch: &MapPatch| patch.tiles.iter().map(|tile| (tile.x, tile.y)).collect::<Vec<_>>();
    if places(made) != places(recorded) {
        return format!("{} tiles changed, recorded {}", made.tiles.len(), recorded.tiles.len());
    }
    let cells = made.tiles.iter().zip(&recorded.tiles);
    let differing: usize = cells
        .map(|(made, recorded)| made.values.iter().zip(&recorded.values).filter(|(a, b)| a != b).count())
        .sum();
    format!("{differing} cells differ")
}

/// Number of cells of a map, and of those in which another map differs.
fn compare(recorded: &OccupancyGrid, made: &OccupancyGrid) -> (u64, u64) {
    let spec = recorded.spec();
    let differing = recorded
        .values()
        .iter()
        .enumerate()
        .filter(|(index, value)| made.at(spec.center(spec.cell(*index))) != Some(*value))
        .count();
    (spec.len() as u64, differing as u64)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use zenav_mapping::MappingSettings;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::InfoReply;

    use super::*;
    use crate::record::format::Kind;
    use crate::record::made_up;

    fn scan(nth: u64) -> Scan {
        let ranges = (0..180)
            .map(|beam| 1.0 + 0.01 * ((beam * 7 + nth * 13) % 90) as f32)
            .collect();
        Scan {
            base_from_laser: Pose2::new(0.1, 0.0, 0.0),
            ..zenav_fixtures::scan(
                1_000_000_000 + nth * 100_000_000,
                Pose2::new(0.05 * nth as f64, 0.0, 0.02 * nth as f64),
                ranges,
            )
        }
    }

    /// A run in which mapping skipped the scans of `unseen`, and knew the footprint from `learnt` on.
    fn record(path: &Path, unseen: &[u64], learnt: u64, changed: Option<u64>) {
        let mut samples = Vec::new();
        let model = zenav_fixtures::robot("tiago");
        let footprint = model.footprint.clone();
        let info = InfoReply {
            model: Some(model),
            ..InfoReply::default()
        };
        let mut mapper = Mapper::new(MappingSettings::default(), "m");
        for nth in 0..30 {
            if nth == learnt {
                mapper.set_footprint(footprint.clone());
            }
            let logged = 1_000 + nth * 100;
            let mut message = scan(nth);
            if !unseen.contains(&nth) {
                mapper.insert(&message);
            }
            if changed == Some(nth) {
                message.ranges[90] = 0.5;
            }
            samples.push(made_up::sample("zenav/r/edge/scan", &message, logged));
            // Two scans per patch, followed by their description.
            if nth % 2 == 1
                && let Some(patch) = mapper.take_patch()
            {
                let bytes = codec::encode(&patch, Encoding::Cbor).unwrap();
                let key = "zenav/r/cloud/map_patch".to_owned();
                samples.push(Sample::new(key, Kind::Put, Encoding::Cbor, bytes, logged + 10));
                samples.push(made_up::sample("zenav/r/cloud/map", &mapper.info(), logged + 20));
            }
        }
        samples.push(Sample {
            kind: Kind::Reply,
            ..made_up::sample("zenav/r/ask/edge/info", &info, 10_000)
        });
        made_up::record(path, samples);
    }

    fn verdict(unseen: &[u64], learnt: u64, changed: Option<u64>) -> MapVerdict {
        let folder = tempfile::tempdir().unwrap();
        let path: PathBuf = folder.path().join("run.mcap");
        record(&path, unseen, learnt, changed);
        let maps = recompute(&path, &mut RunSettings::default()).unwrap();
        assert_eq!(maps.len(), 1);
        maps.into_iter().next().unwrap()
    }

    #[test]
    fn the_map_of_the_same_scans_is_the_same_byte_for_byte() {
        for learnt in [0, 1, 4, 100] {
            let verdict = verdict(&[], learnt, None);
            assert!(verdict.identical, "{verdict:?}");
            assert_eq!((verdict.patches, verdict.scans, verdict.unseen_scans), (15, 30, 0));
            assert!(verdict.cells > 1000 && verdict.differing_cells == 0);
        }
    }

    #[test]
    fn scans_that_mapping_never_saw_are_found_out() {
        let verdict = verdict(&[0, 7, 12], 3, None);
        assert!(verdict.identical, "{verdict:?}");
        assert_eq!(verdict.unseen_scans, 3);
    }

    #[test]
    fn another_scan_makes_another_map_and_the_first_difference_is_named() {
        let verdict = verdict(&[], 0, Some(9));
        assert!(!verdict.identical);
        let why = verdict.difference.unwrap();
        assert!(why.starts_with("revision 5: ") && why.contains("differ"), "{why}");
        assert!((4..15).contains(&verdict.same_patches), "{}", verdict.same_patches);
    }

    #[test]
    fn a_map_whose_beginning_is_missing_is_not_compared() {
        let folder = tempfile::tempdir().unwrap();
        let (whole, part) = (folder.path().join("run.mcap"), folder.path().join("part.mcap"));
        record(&whole, &[], 0, None);
        let mut reader = RecordReader::open(&whole).unwrap();
        let all = std::iter::from_fn(|| reader.next_sample().unwrap());
        // Like a recorder that joins late: the patches are retained for it, the scans are not.
        let heard = all.filter(|sample| sample.logged >= 2_000 || !sample.key.ends_with("scan"));
        made_up::record(&part, heard);
        let map = &recompute(&part, &mut RunSettings::default()).unwrap()[0];
        assert!(!map.identical && map.same_patches == 0, "{map:?}");
        let why = map.difference.as_ref().unwrap();
        assert!(
            why.contains("began later") && why.contains("start the recorder before mapping"),
            "{why}"
        );
    }

    #[test]
    fn choices_begin_with_the_newest_and_end() {
        assert_eq!(choices(&[1, 2, 3], 2), [vec![2, 3], vec![1, 3], vec![1, 2]]);
        assert_eq!(choices(&[1, 2], 2), [vec![1, 2]]);
        assert_eq!(choices(&[1, 2], 0), [Vec::<usize>::new()]);
        assert_eq!(choices(&(0..60).collect::<Vec<_>>(), 30).len(), CHOICES);
    }
}
