//! Floor. Builds the text of a world file, with walls around it.

use std::fmt::Write as _;

/// Thickness of the outer walls, m.
const WALL: f64 = 0.1;
/// Radius of a person as a disc, m.
pub(super) const PERSON: f64 = 0.25;
/// Rest of a mover that stays for good, s.
pub(super) const FOR_GOOD: f64 = 10_000.0;

/// A walled rectangle from the origin.
#[derive(Clone)]
pub(super) struct Floor {
    size: [f64; 2],
    start: [f64; 3],
    things: String,
}

impl Floor {
    /// A floor of this inner width and height, m; the robot starts at this pose.
    pub(super) fn new(size: [f64; 2], start: [f64; 3]) -> Self {
        let mut things = String::new();
        let [w, h] = size;
        let (low, half) = (-WALL, 0.5 * WALL);
        for (from, to) in [
            ([low, -half], [w + WALL, -half]),
            ([low, h + half], [w + WALL, h + half]),
            ([-half, low], [-half, h + WALL]),
            ([w + half, low], [w + half, h + WALL]),
        ] {
            // Writing to a String cannot fail.
            let _ = writeln!(things, "[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = {WALL}");
        }
        Self { size, start, things }
    }

    /// The same floor with another start.
    pub(super) fn starting(mut self, start: [f64; 3]) -> Self {
        self.start = start;
        self
    }

    /// A solid box between two corners, m.
    pub(super) fn block(mut self, [l, b]: [f64; 2], [r, t]: [f64; 2]) -> Self {
        let _ = writeln!(
            self.things,
            "[[polygon]]\npoints = [[{l}, {b}], [{r}, {b}], [{r}, {t}], [{l}, {t}]]"
        );
        self
    }

    /// A solid disc, m.
    pub(super) fn disc(mut self, [x, y]: [f64; 2], radius: f64) -> Self {
        let _ = writeln!(self.things, "[[circle]]\nx = {x}\ny = {y}\nradius = {radius}");
        self
    }

    /// A disc on a closed path with rests at its corners, s.
    pub(super) fn mover(mut self, radius: f64, speed: f64, path: &[([f64; 2], f64)]) -> Self {
        let (path, rests): (Vec<[f64; 2]>, Vec<f64>) = path.iter().copied().unzip();
        let _ = writeln!(
            self.things,
            "[[mover]]\nradius = {radius}\nspeed = {speed}\npath = {path:?}\nrest_secs = {rests:?}"
        );
        self
    }

    /// A person who walks between random places all over the floor.
    pub(super) fn walker(mut self, speed: f64, start: [f64; 2]) -> Self {
        let [w, h] = self.size.map(|side| side - 2.0 * PERSON);
        let _ = writeln!(
            self.things,
            "[[mover]]\nradius = {PERSON}\nspeed = {speed}\nwalk = [[{l}, {l}], [{r}, {t}]]\nstart = {start:?}",
            l = 2.0 * PERSON,
            r = w,
            t = h
        );
        self
    }

    /// A sliding door between two points: closed for `shut` s, open for `open` s.
    pub(super) fn door(mut self, from: [f64; 2], to: [f64; 2], shut: f64, open: f64) -> Self {
        let _ = writeln!(
            self.things,
            "[[door]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.06\nclosed_secs = {shut}\nopen_secs = {open}\nslide_secs = 1.5"
        );
        self
    }

    /// A sensor fault, by the keys of its table.
    pub(super) fn fault(mut self, keys: &str) -> Self {
        let _ = writeln!(self.things, "[[fault]]\n{keys}");
        self
    }

    /// A person who makes way, on a path with rests, s.
    pub(super) fn person(self, manners: &str, speed: f64, path: &[([f64; 2], f64)]) -> Self {
        let mut floor = self.mover(PERSON, speed, path);
        let _ = writeln!(floor.things, "manners = \"{manners}\"");
        floor
    }

    /// The text of the world file.
    pub(super) fn text(&self, name: &str) -> String {
        let [w, h] = self.size.map(|side| side + 2.0 * WALL);
        let [x, y, yaw] = self.start;
        format!(
            "name = \"{name}\"\nsize = [{w}, {h}]\norigin = [-{WALL}, -{WALL}]\n[start]\nx = {x}\ny = {y}\nyaw = {yaw}\n{}",
            self.things
        )
    }
}
