//! Publications. What does the leader publish of its map, and when?

use std::time::Instant;

use zenav_observability::trace;
use zenav_protocol::bus::{Bus, BusError, Publisher};
use zenav_protocol::messages::{Annotations, Correction, Localisation, MapFrame, MapInfo, MapPatch, PoseGraph};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{ANNOTATIONS, CORRECTION, GRAPH, LOCALISATION, MAP_FRAME, MAP_INFO, MAP_PATCH};

use super::Leadership;

/// The topics that a leader writes, besides its beats.
pub(super) struct Outbox {
    pub(super) info: Publisher<MapInfo>,
    pub(super) patches: Publisher<MapPatch>,
    pub(super) frames: Publisher<MapFrame>,
    pub(super) corrections: Publisher<Correction>,
    pub(super) localisation: Publisher<Localisation>,
    pub(super) graphs: Publisher<PoseGraph>,
    pub(super) annotations: Publisher<Annotations>,
}

impl Outbox {
    /// Declares the topics of a robot.
    ///
    /// # Errors
    /// If the bus is closed, or a key cannot be declared.
    pub(super) fn open(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        let chunks = [robot];
        Ok(Self {
            info: bus.publisher(&MAP_INFO, &chunks)?,
            patches: bus.publisher(&MAP_PATCH, &chunks)?,
            frames: bus.publisher(&MAP_FRAME, &chunks)?,
            corrections: bus.publisher(&CORRECTION, &chunks)?,
            localisation: bus.publisher(&LOCALISATION, &chunks)?,
            graphs: bus.publisher(&GRAPH, &chunks)?,
            annotations: bus.publisher(&ANNOTATIONS, &chunks)?,
        })
    }
}

impl Leadership {
    /// Publishes everything once, at the beginning: frame, map, and places and zones.
    pub(super) async fn introduce(&mut self, now: Stamp) {
        let frame = self.core.untold_frame(Stamp::ZERO);
        if let Some(frame) = &frame {
            self.carry_over(frame);
        }
        let _ = self.keep(now, false).await;
        if let Some(frame) = frame {
            self.outbox.frames.put(&frame);
            self.frame = frame;
        }
        self.publish(now);
        self.tell_info();
        self.outbox.annotations.put(self.annotations.now());
    }

    /// Moves places and zones into a new frame that is not published yet.
    pub(super) fn carry_over(&mut self, frame: &MapFrame) {
        if self.frame.map.frame != frame.map.frame {
            self.annotations.carry_over(&self.frame, frame);
        }
    }

    /// Publishes the poses of the map's parts. Returns whether they are in a new frame: its places and zones are published with it, and the
    /// map is to follow.
    pub(super) fn tell_frame(&mut self, frame: MapFrame) -> bool {
        let before = std::mem::replace(&mut self.frame, frame);
        self.outbox.frames.put(&self.frame);
        let is_new = before.map.frame != self.frame.map.frame;
        if is_new {
            self.outbox.annotations.put(self.annotations.now());
        }
        is_new
    }

    /// Publishes the changes since the last patch, if there are any, and the description of the map.
    pub(super) fn publish(&mut self, now: Stamp) {
        self.published = now;
        let began = Instant::now();
        let patch = self.core.mapper.take_patch();
        // A map of many tiles is published in several patches, one each period.
        self.pending = patch.is_some() && self.core.mapper.has_changes();
        if let Some(patch) = patch {
            let trace = self.trace.take();
            let span = trace.and_then(|trace| trace::child(&trace, &self.part(), "map published"));
            self.outbox
                .patches
                .put_in(span.as_ref().map(trace::Span::context).or(trace), &patch);
            if let Some(span) = span {
                span.with("revision", patch.map.revision).end();
            }
            self.tell_info();
            self.metrics.published(began);
        }
    }

    /// Publishes the description of the map.
    pub(super) fn tell_info(&self) {
        let info = self.core.mapper.info();
        self.pulse.name_map(&info.map, self.core.mapper.is_held());
        self.metrics.map(&info);
        self.outbox.info.put(&info);
    }
}
