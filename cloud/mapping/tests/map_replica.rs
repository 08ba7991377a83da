//! Tests that a replica fed by the mapper's patches equals the map.
#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::Point2;
use proptest::prelude::*;
use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{MapPatch, MapRef, Scan};
use zenav_protocol::padding::Extent;

fn scan(stamp: u64, x: f64, y: f64) -> Scan {
    let ranges = (0..60).map(|beam| 0.5 + 0.1 * beam as f32).collect();
    zenav_fixtures::scan(stamp, Pose2::new(x, y, 0.0), ranges)
}

proptest! {
    #[test]
    fn a_replica_that_loses_patches_heals_by_asking_for_the_whole_map(steps in proptest::collection::vec((-20.0..20.0, -20.0..20.0, any::<bool>(), 1_usize..4), 1..15)) {
        let mut mapper = Mapper::new(MappingSettings { patch_tiles: 7, ..MappingSettings::default() }, "m");
        let mut replica = MapReplica::new();
        for (step, (x, y, lost, patches)) in steps.iter().enumerate() {
            mapper.insert(&scan(step as u64 + 1, *x, *y));
            for _ in 0..*patches {
                let Some(patch) = mapper.take_patch() else { break };
                if *lost {
                    continue;
                }
                if replica.apply(&patch) == PatchResult::Gap {
                    prop_assert!(replica.replace(&mapper.reply()));
                }
                prop_assert_eq!(replica.map(), mapper.map());
            }
        }
        while let Some(patch) = mapper.take_patch() {
            if replica.apply(&patch) == PatchResult::Gap {
                prop_assert!(replica.replace(&mapper.reply()));
            }
        }
        if replica.map() != mapper.map() {
            prop_assert!(replica.replace(&mapper.reply()));
        }
        prop_assert_eq!(replica.grid(), &mapper.grid());
    }
}

#[test]
fn malformed_patches_change_nothing() {
    let mut mapper = Mapper::new(MappingSettings::default(), "m");
    mapper.insert(&scan(1, 0.0, 0.0));
    let good = mapper.take_patch().unwrap();
    let mut replica = MapReplica::new();
    let wrong: [fn(&mut MapPatch); 7] = [
        |patch| patch.spec.width = u32::MAX,
        |patch| (patch.spec.width, patch.spec.height) = (32_768, 32_768),
        |patch| patch.spec.resolution = f64::NAN,
        |patch| patch.tiles[0].values.truncate(10),
        |patch| patch.tiles[0].x = u32::MAX,
        |patch| patch.map.id.clear(),
        |patch| patch.base_revision = 5,
    ];
    for spoil in wrong {
        let mut patch = good.clone();
        spoil(&mut patch);
        assert_eq!(replica.apply(&patch), PatchResult::Gap);
        assert!(!replica.has_map());
    }
    assert_eq!(replica.apply(&good), PatchResult::Applied);
    assert_eq!(replica.apply(&good), PatchResult::Old);
    // The grid must not shift by a fraction of a cell.
    let mut slipped = good.clone();
    slipped.base_revision = 1;
    slipped.map.revision = 2;
    slipped.spec.origin.x += 0.02;
    assert_eq!(replica.apply(&slipped), PatchResult::Gap);
    assert_eq!(replica.grid(), &mapper.grid());
}

#[test]
fn a_new_map_takes_the_place_of_the_old_one() {
    let mut replica = MapReplica::new();
    for id in ["first", "second"] {
        let mut mapper = Mapper::new(MappingSettings::default(), id);
        mapper.insert(&scan(1, 3.0, 4.0));
        assert_eq!(replica.apply(&mapper.take_patch().unwrap()), PatchResult::Applied);
        assert_eq!(replica.grid(), &mapper.grid());
        assert!(replica.holds(mapper.map()) && !replica.holds(&MapRef::new(id, 2)));
    }
}

#[test]
fn a_padded_replica_holds_the_same_map_and_nothing_else() {
    let mut mapper = Mapper::new(MappingSettings::default(), "m");
    let (mut far, mut exact) = (MapReplica::new(), MapReplica::new());
    for (step, x) in [0.0, 4.0, -9.0, 12.0, 12.5].into_iter().enumerate() {
        mapper.insert(&scan(step as u64 + 1, x, 0.5 * x));
        while let Some(patch) = mapper.take_patch() {
            assert_eq!(far.apply(&patch), PatchResult::Applied);
            assert_eq!(exact.apply(&patch), PatchResult::Applied);
        }
        if step == 1 {
            far.reach(&Extent {
                places: vec![Point2::new(-30.0, 21.0)],
                ring: 1.0,
            });
        } else if step == 3 {
            assert!(far.replace(&mapper.reply()));
        }
    }
    assert_eq!(exact.grid().values(), mapper.grid().values());
    let (large, small) = (far.grid().spec(), exact.grid().spec());
    assert!(large.cell_at(Point2::new(-30.9, 21.9)).is_some() && small.cell_at(Point2::new(-30.0, 21.0)).is_none());
    for y in 0..large.height {
        for x in 0..large.width {
            let cell = zenav_protocol::grid::Cell::new(x, y);
            let known = small
                .cell_at(large.center(cell))
                .and_then(|cell| exact.grid().get(cell));
            assert_eq!(far.grid().get(cell), known.or(Some(&Occupancy::UNKNOWN)), "{cell:?}");
        }
    }
}
