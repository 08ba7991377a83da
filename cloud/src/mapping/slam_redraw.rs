//! Redraw. SLAM's map drawn anew, after a closure has moved its parts.
//!
//! The scans that arrive do not wait for it: it is of the scans and poses at one moment, and the new map replaces the old one with a later
//! scan. Which one follows from the stamps and from the number of scans alone, so the map is the same whether another thread has drawn it
//! until then or not.

use std::sync::{Arc, OnceLock};

use zenav_mapping::Mapper;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;
use zenav_slam::{Slam, Solve};

/// Time from the start of a redraw to the new map, by the stamps of scans, s for each scan: twice its processor time or more.
const DRAWN_AFTER: f64 = 1e-4;
/// Scans drawn between two looks whether the map is still wanted.
const CHUNK: usize = 100;

/// A map to be drawn, and the drawn map.
#[derive(Debug)]
pub(super) struct Drawing {
    /// What it is drawn over: nothing, or the map that SLAM began in.
    begun: Mapper,
    scans: Vec<Arc<Scan>>,
    /// `map_from_base` at each scan.
    poses: Vec<Pose2>,
    drawn: OnceLock<Mapper>,
}

impl Drawing {
    /// The drawn map; it is drawn once, whoever asks first. The drawing ends early once it is not wanted any more.
    pub(super) fn map(&self, is_wanted: impl Fn() -> bool) -> &Mapper {
        self.drawn.get_or_init(|| {
            let mut mapper = self.begun.clone();
            let chunks = self.scans.chunks(CHUNK).zip(self.poses.chunks(CHUNK));
            for (scans, poses) in chunks.take_while(|_| is_wanted()) {
                draw(&mut mapper, scans, poses);
            }
            mapper
        })
    }
}

/// Draws scans from their poses.
fn draw(mapper: &mut Mapper, scans: &[Arc<Scan>], poses: &[Pose2]) {
    for (scan, pose) in scans.iter().zip(poses) {
        mapper.insert(&Scan {
            map_from_odom: *pose * scan.odom_from_base.inverse(),
            ..Scan::clone(scan)
        });
    }
}

/// A redraw of the map in progress.
#[derive(Clone, Debug)]
pub(super) struct Redraw {
    drawing: Arc<Drawing>,
    begun: Stamp,
    /// Poses of the map's parts in the new map.
    pub(super) parts: Vec<Pose2>,
}

impl Redraw {
    /// Begins to redraw the map of `mapper` at a stamp, from the scans of all nodes, over the map that SLAM began in, if there is one.
    pub(super) fn begin(mapper: &Mapper, base: Option<&Mapper>, slam: &Slam, scans: &[Arc<Scan>], now: Stamp) -> Self {
        let drawing = Drawing {
            begun: base.map_or_else(|| mapper.redrawing(), |base| mapper.redrawing_over(base)),
            scans: scans.to_vec(),
            poses: slam.nodes().to_vec(),
            drawn: OnceLock::new(),
        };
        Self {
            drawing: Arc::new(drawing),
            begun: now,
            parts: slam.parts(),
        }
    }

    /// Whether the new map replaces the old one at a stamp.
    pub(super) fn is_due(&self, now: Stamp) -> bool {
        // After a restart of the robot its clock may be before the beginning.
        now < self.begun || now.secs_since(self.begun) >= DRAWN_AFTER * self.drawing.scans.len() as f64
    }

    /// Whether the new map is due at a stamp, but not drawn yet.
    pub(super) fn is_late(&self, now: Stamp) -> bool {
        self.is_due(now) && self.drawing.drawn.get().is_none()
    }

    /// The new map, with the scans of the nodes inserted since it was begun.
    pub(super) fn finish(&self, slam: &Slam, scans: &[Arc<Scan>]) -> Mapper {
        let mut mapper = self.drawing.map(|| true).clone();
        let known = self.drawing.scans.len();
        let new = scans.get(known..).zip(slam.nodes().get(known..));
        if let Some((scans, poses)) = new {
            draw(&mut mapper, scans, poses);
        }
        mapper
    }

    pub(super) fn ahead(&self) -> Ahead {
        Ahead::Redraw(Arc::clone(&self.drawing))
    }
}

/// Work for a coming scan that any thread may do before it arrives.
#[derive(Clone, Debug)]
pub(super) enum Ahead {
    /// The graph's next poses, and their certificate.
    Solve(Arc<Solve>),
    /// The map at them.
    Redraw(Arc<Drawing>),
}

impl Ahead {
    /// Does it, unless somebody has.
    pub(super) fn run(&self) {
        match self {
            Self::Solve(solve) => solve.run(),
            Self::Redraw(drawing) => {
                // The last one that holds a drawing draws for nobody.
                drawing.map(|| Arc::strong_count(drawing) > 1);
            }
        }
    }
}
