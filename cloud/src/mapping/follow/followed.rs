//! Followed. What does a copy know of the leader, and of its map?

use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{Annotations, EdgeState, MapInfo, MapPatch, MapRef, MapReply, MappingLeader};

use super::super::succession::{Holds, is_leader};
use super::MOST_PATCHES;

/// What a copy knows of the leader, and of what the leader has published.
#[derive(Clone, Debug, Default)]
pub(in crate::mapping) struct Followed {
    /// The leader; `None` before one was heard.
    pub(in crate::mapping) leader: Option<MappingLeader>,
    /// The leader's map.
    pub(in crate::mapping) replica: MapReplica,
    /// Patches that came while the whole map was on its way.
    pub(in crate::mapping) early: Vec<MapPatch>,
    /// Description of the map.
    pub(in crate::mapping) info: Option<MapInfo>,
    /// Places and zones.
    pub(in crate::mapping) annotations: Option<Annotations>,
    /// The robot's last state.
    pub(in crate::mapping) state: Option<EdgeState>,
}

impl Followed {
    /// Takes a beat; returns whether it is of the leader.
    pub(super) fn hears(&mut self, beat: MappingLeader) -> bool {
        let is_leader = is_leader(&beat, self.leader.as_ref());
        if is_leader {
            let known = self.leader.replace(beat.clone()).unwrap_or_default();
            if known.map.id != beat.map.id {
                // One that still loads its map names none.
                let was_reset = known.name == beat.name && !known.map.id.is_empty() && beat.map.revision == 0;
                if was_reset {
                    self.replica = MapReplica::new();
                }
                self.catch_up();
            }
        }
        is_leader
    }

    /// Whether a map is the one that the leader writes.
    fn is_leaders(&self, map: &MapRef) -> bool {
        self.leader.as_ref().is_some_and(|leader| leader.map.id == map.id)
    }

    /// The leader whose map the replica holds, at this revision or at an older one. A leader that has no map yet passes on that of the one
    /// before.
    pub(in crate::mapping) fn inherited(&self) -> Option<&MappingLeader> {
        let leader = self.leader.as_ref()?;
        let is_leaders = self.is_leaders(self.replica.map()) || leader.map.revision == 0;
        (self.replica.has_map() && is_leaders).then_some(leader)
    }

    /// Which map this copy holds; `own`: its own name.
    pub(super) fn holds(&self, own: &str) -> Holds {
        match self.inherited() {
            None => Holds::Nothing,
            Some(leader) if leader.name == own => Holds::Own,
            Some(_) => Holds::Followed,
        }
    }

    /// Whether the leader has a map with cells that the replica does not hold.
    pub(super) fn is_behind(&self) -> bool {
        let leader = self.leader.as_ref();
        leader.is_some_and(|leader| leader.map.revision > 0 && !self.replica.holds(&leader.map))
    }

    /// Takes a patch; a missing one before it shows in [`Self::is_behind`]. A map that no beat has named yet waits: it may be a stranger's.
    pub(super) fn take(&mut self, patch: MapPatch) {
        if !self.is_leaders(&patch.map) || self.replica.apply(&patch) == PatchResult::Gap {
            let over = (self.early.len() + 1).saturating_sub(MOST_PATCHES);
            self.early.drain(..over);
            self.early.push(patch);
        }
    }

    /// Applies the early patches of the leader's map, and drops all others.
    fn catch_up(&mut self) {
        for patch in std::mem::take(&mut self.early) {
            if self.is_leaders(&patch.map) {
                let _ = self.replica.apply(&patch);
            }
        }
    }

    /// Takes over a whole map, unless patches have overtaken it.
    pub(super) fn replace(&mut self, reply: &MapReply) {
        let is_newer = self.is_leaders(&reply.info.map) && !self.replica.holds(&reply.info.map);
        if is_newer && self.replica.replace(reply) {
            self.info = Some(reply.info.clone());
        }
        self.catch_up();
    }
}
