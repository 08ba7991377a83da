//! Annotations. Places and zones of a robot's map, and how they change.
//!
//! The base comes from the world and the deployment. Operators' changes are kept in a file as an overlay, so later edits of the base still
//! take effect. A change is on disk before it is published or acknowledged.
//!
//! Coordinates belong to a frame of the map. The file names its frame; the base's coordinates are as configured. [`Carried`] is kept with
//! SLAM's session and holds both in the session's frame: a resumed session has its places and zones where the last run had moved them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use zenav_mapping::atomic::write_atomically;
use zenav_protocol::bus::Request;
use zenav_protocol::messages::{AnnotateAction, AnnotateRequest, Annotations, GoalPoint, MapFrame, Refusal, Zone};
use zenav_protocol::time::Stamp;
use zenav_space::Zones;

use super::{MappingError, Service};

/// Name of the file in a robot's folder.
const FILE: &str = "annotations.json";
/// Largest file that is read, bytes.
const MAX_FILE: u64 = 4 << 20;
/// Longest name of a place or zone, bytes.
const MAX_NAME: usize = 64;
/// Most places.
const MAX_PLACES: usize = 1000;
/// Most corners of all zones: the published message stays within its key's limit.
const MAX_CORNERS: usize = 20_000;

/// Changes by operators; `None` marks a place or zone of the base as removed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Overlay {
    #[serde(default)]
    revision: u64,
    /// Map frame of its coordinates.
    #[serde(default)]
    frame: u64,
    #[serde(default)]
    places: BTreeMap<String, Option<GoalPoint>>,
    #[serde(default)]
    zones: BTreeMap<String, Option<Zone>>,
}

/// Places and zones that a frame change has moved: name, coordinates as given, and coordinates in the session's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Carried {
    places: Vec<(String, GoalPoint, GoalPoint)>,
    zones: Vec<(String, Zone, Zone)>,
    changed_places: Vec<(String, GoalPoint, GoalPoint)>,
    changed_zones: Vec<(String, Zone, Zone)>,
}

/// The items that differ from how they were given; both iterators have the same order.
fn carried<'a, T: Clone + PartialEq + 'a>(
    given: impl Iterator<Item = (&'a String, &'a T)>,
    now: impl Iterator<Item = &'a T>,
) -> Vec<(String, T, T)> {
    let pairs = given.zip(now).filter(|((_, given), now)| given != now);
    pairs
        .map(|((name, given), now)| (name.clone(), given.clone(), now.clone()))
        .collect()
}

/// Moves an item to where it was carried if it is still as given; an item edited since stays as it is.
fn carry<T: Clone + PartialEq>(carried: &[(String, T, T)], name: &str, item: &mut T) {
    let known = carried.iter().find(|(known, given, _)| known == name && given == item);
    if let Some((_, _, now)) = known {
        *item = now.clone();
    }
}

impl Overlay {
    /// Its places.
    fn places(&self) -> impl Iterator<Item = (&String, &GoalPoint)> {
        self.places
            .iter()
            .filter_map(|(name, place)| Some((name, place.as_ref()?)))
    }

    /// Its zones.
    fn zones(&self) -> impl Iterator<Item = (&String, &Zone)> {
        self.zones
            .iter()
            .filter_map(|(name, zone)| Some((name, zone.as_ref()?)))
    }
}

/// The annotations of one robot's map.
#[derive(Debug)]
pub(super) struct AnnotationBook {
    base: Annotations,
    overlay: Overlay,
    /// Base and overlay as given: by world and deployment, and in the file.
    given: (Annotations, Overlay),
    file: Option<PathBuf>,
    now: Annotations,
}

impl AnnotationBook {
    /// The base, overlaid with the changes of earlier runs.
    ///
    /// # Errors
    /// [`MappingError::Annotations`] for an unreadable file: a keep-out zone must not vanish silently.
    pub(super) fn open(
        places: BTreeMap<String, GoalPoint>,
        zones: &Zones,
        folder: Option<&Path>,
    ) -> Result<Self, MappingError> {
        let file = folder.map(|folder| folder.join(FILE));
        let overlay = match &file {
            Some(file) => read(file).map_err(|problem| MappingError::Annotations {
                file: file.clone(),
                problem,
            })?,
            None => Overlay::default(),
        };
        let base = Annotations {
            revision: 0,
            places,
            zones: with_own_names(zones.to_messages()),
            frame: 0,
        };
        let now = laid_over(&base, &overlay);
        Ok(Self {
            given: (base.clone(), overlay.clone()),
            base,
            overlay,
            file,
            now,
        })
    }

    /// Resumes in a frame of the map, with places and zones where the session had carried them.
    pub(super) fn go_on(&mut self, carried: &Carried, frame: u64) {
        for (name, place) in &mut self.base.places {
            carry(&carried.places, name, place);
        }
        for zone in &mut self.base.zones {
            let name = zone.name.clone();
            carry(&carried.zones, &name, zone);
        }
        // An overlay written in this frame already has the right coordinates.
        if self.overlay.frame != frame {
            for (name, place) in &mut self.overlay.places {
                if let Some(place) = place {
                    carry(&carried.changed_places, name, place);
                }
            }
            for (name, zone) in &mut self.overlay.zones {
                if let Some(zone) = zone {
                    carry(&carried.changed_zones, name, zone);
                }
            }
        }
        self.are_in(frame);
    }

    /// Where places and zones were carried, for the stored session.
    pub(super) fn carried(&self) -> Carried {
        let (base, overlay) = &self.given;
        let zones = base.zones.iter().map(|zone| (&zone.name, zone));
        Carried {
            places: carried(base.places.iter(), self.base.places.values()),
            zones: carried(zones, self.base.zones.iter()),
            changed_places: carried(overlay.places(), self.overlay.places().map(|(_, place)| place)),
            changed_zones: carried(overlay.zones(), self.overlay.zones().map(|(_, zone)| zone)),
        }
    }

    /// Sets the frame of all coordinates.
    fn are_in(&mut self, frame: u64) {
        self.base.frame = frame;
        self.overlay.frame = frame;
        self.now = laid_over(&self.base, &self.overlay);
    }

    /// The annotations in force.
    pub(super) fn now(&self) -> &Annotations {
        &self.now
    }

    /// Keeps places and zones fixed in the building: each moves with the part of the map that it belongs to, a zone as a rigid body.
    pub(super) fn carry_over(&mut self, before: &MapFrame, after: &MapFrame) {
        let is_same = before.map.id == after.map.id;
        let moved = |x: f64, y: f64| is_same.then(|| before.moved_at(x, y, after)).flatten();
        let carry = |place: &mut GoalPoint| {
            if let Some(moved) = moved(place.x, place.y) {
                *place = place.moved(moved);
            }
        };
        let carry_zone = |zone: &mut Zone| {
            let count = zone.points.len().max(1) as f64;
            let middle = zone
                .points
                .iter()
                .fold((0.0, 0.0), |(x, y), point| (x + point.x / count, y + point.y / count));
            if let Some(moved) = moved(middle.0, middle.1) {
                for point in &mut zone.points {
                    *point = moved.transform_point(*point);
                }
            }
        };
        self.base.places.values_mut().for_each(carry);
        self.overlay.places.values_mut().flatten().for_each(carry);
        self.base.zones.iter_mut().for_each(carry_zone);
        self.overlay.zones.values_mut().flatten().for_each(carry_zone);
        self.are_in(after.map.frame);
    }

    /// Carries out a change and stores it; returns whether anything changed.
    async fn change(&mut self, action: AnnotateAction) -> Result<bool, Refusal> {
        let Some(overlay) = self.changed(action)? else {
            return Ok(false);
        };
        if let Some(file) = self.file.clone() {
            let text = serde_json::to_vec_pretty(&overlay).map_err(Refusal::internal)?;
            let store = move || {
                if let Some(folder) = file.parent() {
                    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
                }
                write_atomically(&file, &text).map_err(|error| error.to_string())
            };
            let stored = tokio::task::spawn_blocking(store).await;
            stored.map_err(Refusal::internal)?.map_err(Refusal::internal)?;
        }
        self.given.1.clone_from(&overlay);
        self.overlay = overlay;
        self.now = laid_over(&self.base, &self.overlay);
        Ok(true)
    }

    /// The overlay after a change; `None` if nothing changes.
    fn changed(&self, action: AnnotateAction) -> Result<Option<Overlay>, Refusal> {
        let mut overlay = self.overlay.clone();
        match action {
            AnnotateAction::Get => return Ok(None),
            AnnotateAction::AddPlace { name, at } => {
                check_name(&name)?;
                overlay
                    .places
                    .insert(name, Some(at.checked().map_err(Refusal::bad_request)?));
            }
            AnnotateAction::RemovePlace { name } => {
                if !self.now.places.contains_key(&name) {
                    return Err(unknown("place", &name, self.now.places.keys()));
                }
                overlay.places.insert(name, None);
            }
            AnnotateAction::AddZone { zone } => {
                check_name(&zone.name)?;
                Zones::new(std::slice::from_ref(&zone)).map_err(Refusal::bad_request)?;
                overlay.zones.insert(zone.name.clone(), Some(zone));
            }
            AnnotateAction::RemoveZone { name } => {
                if !self.now.zones.iter().any(|zone| zone.name == name) {
                    return Err(unknown("zone", &name, self.now.zones.iter().map(|zone| &zone.name)));
                }
                overlay.zones.insert(name, None);
            }
            AnnotateAction::ClearZones => {
                overlay.zones = self.base.zones.iter().map(|zone| (zone.name.clone(), None)).collect();
            }
        }
        // The removal of an item that the base does not have need not be recorded.
        let base = &self.base;
        overlay
            .places
            .retain(|name, place| place.is_some() || base.places.contains_key(name));
        overlay
            .zones
            .retain(|name, zone| zone.is_some() || base.zones.iter().any(|known| known.name == *name));
        let after = laid_over(base, &overlay);
        if (&after.places, &after.zones) == (&self.now.places, &self.now.zones) {
            return Ok(None);
        }
        if after.places.len() > MAX_PLACES {
            return Err(Refusal::rejected(format!("{MAX_PLACES} places: no more may be added")));
        }
        let corners: usize = after.zones.iter().map(|zone| zone.points.len()).sum();
        if corners > MAX_CORNERS {
            return Err(Refusal::rejected(format!(
                "the zones would have {corners} corners: expected at most {MAX_CORNERS}"
            )));
        }
        Zones::new(&after.zones).map_err(Refusal::rejected)?;
        overlay.revision += 1;
        Ok(Some(overlay))
    }
}

fn laid_over(base: &Annotations, overlay: &Overlay) -> Annotations {
    let mut places: BTreeMap<_, _> = base.places.clone();
    for (name, place) in &overlay.places {
        match place {
            Some(place) => places.insert(name.clone(), *place),
            None => places.remove(name),
        };
    }
    let mut zones: BTreeMap<String, Zone> = base
        .zones
        .iter()
        .map(|zone| (zone.name.clone(), zone.clone()))
        .collect();
    for (name, zone) in &overlay.zones {
        match zone {
            Some(zone) => zones.insert(name.clone(), zone.clone()),
            None => zones.remove(name),
        };
    }
    Annotations {
        revision: overlay.revision,
        places,
        zones: zones.into_values().collect(),
        frame: base.frame,
    }
}

/// Zones of a file may share a name; here each gets its own.
fn with_own_names(zones: Vec<Zone>) -> Vec<Zone> {
    let mut named: Vec<Zone> = Vec::with_capacity(zones.len());
    for mut zone in zones {
        let name = zone.name.clone();
        let mut count = 1;
        while named.iter().any(|known| known.name == zone.name) {
            count += 1;
            zone.name = format!("{name}_{count}");
        }
        named.push(zone);
    }
    named
}

fn read(file: &Path) -> Result<Overlay, String> {
    let size = match std::fs::metadata(file) {
        Ok(found) => found.len(),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Overlay::default()),
        Err(error) => return Err(error.to_string()),
    };
    if size > MAX_FILE {
        return Err(format!("{size} bytes: expected at most {MAX_FILE}"));
    }
    let text = std::fs::read(file).map_err(|error| error.to_string())?;
    let overlay: Overlay = serde_json::from_slice(&text).map_err(|error| error.to_string())?;
    for place in overlay.places.values().flatten() {
        place.checked()?;
    }
    let zones: Vec<Zone> = overlay.zones.values().flatten().cloned().collect();
    Zones::new(&zones).map_err(|error| error.to_string())?;
    Ok(overlay)
}

fn check_name(name: &str) -> Result<(), Refusal> {
    let is_plain = !name.trim().is_empty() && name.len() <= MAX_NAME && !name.chars().any(char::is_control);
    // `|` and `;` separate goals in the ports of a tree.
    if is_plain && !name.contains(['|', ';']) && name.trim() == name {
        return Ok(());
    }
    let found: String = name.chars().take(MAX_NAME).collect();
    Err(Refusal::bad_request(format!(
        "the name {found:?}: expected 1 to {MAX_NAME} bytes without `|`, `;`, line breaks or spaces at its ends"
    )))
}

fn unknown<'a>(kind: &str, name: &str, known: impl Iterator<Item = &'a String>) -> Refusal {
    let name: String = name.chars().take(MAX_NAME).collect();
    let known: Vec<&str> = known.take(20).map(String::as_str).collect();
    let known = if known.is_empty() {
        "there is none".to_owned()
    } else {
        format!("there are {}", known.join(", "))
    };
    Refusal::NotFound {
        what: format!("{kind} `{name}`; {known}"),
    }
}

impl Service {
    /// Answers a request for the annotations; a change is carried out once, under the lease in force.
    pub(super) async fn annotate(&mut self, request: Request<AnnotateRequest, Annotations>, now: Stamp) {
        let AnnotateRequest {
            action,
            request_id,
            epoch,
        } = request.body.clone();
        if action == AnnotateAction::Get {
            request.reply(self.annotations.now());
            return;
        }
        let answer = match self.annotated.get(request_id.as_deref()) {
            Some(first) => first,
            None => match self.authority.admit(now, epoch) {
                Err(refusal) => Err(refusal),
                Ok(()) => {
                    let changed = self.annotations.change(action).await;
                    if changed == Ok(true) {
                        self.annotations_topic.put(self.annotations.now());
                    }
                    let answer = changed.map(|_| Arc::new(self.annotations.now().clone()));
                    self.annotated.keep(request_id, &answer);
                    answer
                }
            },
        };
        match answer {
            Ok(annotations) => request.reply(&annotations),
            Err(refusal) => request.refuse(&refusal),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::ZoneRule;

    use super::*;

    fn at(x: f64) -> GoalPoint {
        GoalPoint { x, y: 0.0, yaw: None }
    }

    fn zone(name: &str, side: f64) -> Zone {
        Zone {
            name: name.into(),
            rule: ZoneRule::KeepOut,
            points: [[0.0, 0.0], [side, 0.0], [side, side]].map(Point2::from).into(),
        }
    }

    fn add(name: &str, x: f64) -> AnnotateAction {
        AnnotateAction::AddPlace {
            name: name.into(),
            at: at(x),
        }
    }

    fn book(folder: &Path) -> AnnotationBook {
        let zones = Zones::new(&[zone("stairs", 1.0)]).unwrap();
        AnnotationBook::open([("sink".to_owned(), at(1.0))].into(), &zones, Some(folder)).unwrap()
    }

    fn names(book: &AnnotationBook) -> (Vec<String>, Vec<String>) {
        let now = book.now();
        let zones = now.zones.iter().map(|zone| zone.name.clone());
        (now.places.keys().cloned().collect(), zones.collect())
    }

    #[tokio::test]
    async fn what_was_changed_is_there_after_a_restart_and_the_base_may_change_under_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = book(folder.path());
        assert!(first.change(add("fridge", 2.0)).await.unwrap());
        assert!(!first.change(add("fridge", 2.0)).await.unwrap(), "the same again");
        let remove = AnnotateAction::RemovePlace { name: "sink".into() };
        first.change(remove).await.unwrap();
        first
            .change(AnnotateAction::AddZone { zone: zone("wet", 2.0) })
            .await
            .unwrap();
        assert_eq!(first.now().revision, 3);
        let second = book(folder.path());
        assert_eq!(second.now(), first.now());
        assert_eq!(
            names(&second),
            (vec!["fridge".into()], vec!["stairs".into(), "wet".into()])
        );
        let base = AnnotationBook::open(
            [("oven".to_owned(), at(3.0))].into(),
            &Zones::default(),
            Some(folder.path()),
        );
        assert_eq!(
            names(&base.unwrap()),
            (vec!["fridge".into(), "oven".into()], vec!["wet".into()])
        );
    }

    #[tokio::test]
    async fn zones_are_removed_one_by_one_or_all() {
        let folder = tempfile::tempdir().unwrap();
        let mut book = book(folder.path());
        book.change(AnnotateAction::AddZone { zone: zone("wet", 2.0) })
            .await
            .unwrap();
        let remove = AnnotateAction::RemoveZone { name: "stairs".into() };
        book.change(remove.clone()).await.unwrap();
        assert_eq!(names(&book).1, ["wet"]);
        let refusal = book.change(remove).await.unwrap_err().to_string();
        assert!(refusal.contains("zone `stairs`; there are wet"), "{refusal}");
        book.change(AnnotateAction::ClearZones).await.unwrap();
        assert!(names(&book).1.is_empty());
    }

    /// A map of one part, which lies elsewhere in each frame.
    fn frame(number: u64, part: Pose2) -> MapFrame {
        let mut frame = MapFrame {
            parts: vec![part],
            ..MapFrame::default()
        };
        frame.map.frame = number;
        frame
    }

    #[tokio::test]
    async fn a_session_that_goes_on_has_its_places_and_zones_where_it_had_carried_them() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = book(folder.path());
        first.change(add("fridge", 2.0)).await.unwrap();
        let begun = frame(0, Pose2::IDENTITY);
        let moved = frame(1, Pose2::new(0.0, 3.0, 0.0));
        first.carry_over(&begun, &moved);
        let carried = first.carried();
        assert_eq!(
            (first.now().places["sink"].y, first.now().places["fridge"].y),
            (3.0, 3.0)
        );
        let mut again = book(folder.path());
        again.go_on(&carried, 1);
        assert_eq!(again.now(), first.now());
        assert_eq!(again.carried(), carried);

        // An item added in the new frame is in the file with its coordinates, like all others.
        first.change(add("oven", 4.0)).await.unwrap();
        let mut again = book(folder.path());
        again.go_on(&carried, 1);
        assert_eq!(again.now(), first.now());
        assert_eq!(again.now().places["oven"].y, 0.0);
        let turned = frame(2, Pose2::new(0.0, 5.0, 0.0));
        again.carry_over(&moved, &turned);
        let mut third = book(folder.path());
        third.go_on(&again.carried(), 2);
        assert_eq!(third.now(), again.now());
        assert_eq!((third.now().places["sink"].y, third.now().places["oven"].y), (5.0, 2.0));

        // A place of the deployment that was edited meanwhile is where the edit puts it.
        let sinks = [("sink".to_owned(), at(1.5))].into();
        let mut edited = AnnotationBook::open(sinks, &Zones::default(), Some(folder.path())).unwrap();
        edited.go_on(&again.carried(), 2);
        assert_eq!(edited.now().places["sink"], at(1.5));
    }

    #[tokio::test]
    async fn what_cannot_be_is_refused_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut book = book(folder.path());
        let before = book.now().clone();
        for (action, what) in [
            (add("a|b", 1.0), "the name"),
            (add("", 1.0), "the name"),
            (add("far", f64::NAN), "finite"),
            (
                AnnotateAction::AddPlace {
                    name: "turned".into(),
                    at: GoalPoint {
                        yaw: Some(90.0),
                        ..at(0.0)
                    },
                },
                "expected radians",
            ),
            (
                AnnotateAction::AddZone {
                    zone: zone("flat", 0.0),
                },
                "zone `flat`",
            ),
            (AnnotateAction::RemovePlace { name: "moon".into() }, "there are sink"),
        ] {
            let refusal = book.change(action).await.unwrap_err().to_string();
            assert!(refusal.contains(what), "{what}: {refusal}");
        }
        assert_eq!(*book.now(), before);
    }

    #[test]
    fn a_file_that_cannot_be_read_is_not_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE), "{\"places\": 3}").unwrap();
        let error = AnnotationBook::open(BTreeMap::new(), &Zones::default(), Some(folder.path())).unwrap_err();
        assert!(error.to_string().contains(FILE), "{error}");
    }

    #[test]
    fn zones_that_share_a_name_get_names_of_their_own() {
        let zones = with_own_names(vec![zone("a", 1.0), zone("a", 2.0), zone("a", 3.0)]);
        let names: Vec<&str> = zones.iter().map(|zone| zone.name.as_str()).collect();
        assert_eq!(names, ["a", "a_2", "a_3"]);
    }
}
