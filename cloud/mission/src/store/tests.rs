//! Tests of the store: written records are kept, and damaged files are refused.

use ::redb::{Database, ReadableTable as _};
use proptest::prelude::*;
use tempfile::TempDir;

use super::engine::Change;
use super::memory::Memory;
use super::redb::definition;
use super::*;
use zenav_protocol::messages::{GoalPhase, GoalReply, GoalRequest};
use zenav_protocol::time::Stamp;

fn goal(id: &str, sequence: u64) -> Record {
    let request = GoalRequest {
        x: Some(0.1),
        y: Some(0.2),
        ..GoalRequest::default()
    };
    let goal = StoredGoal::accepted(sequence, "r", id.into(), request, false, Stamp(1));
    Record::Goal(Box::new(goal))
}

#[test]
fn what_was_written_is_there_in_the_next_life() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/mission.redb");
    let store = MissionStore::open(&path, "r").unwrap();
    assert_eq!(store.begin_life().unwrap().incarnation, 1);
    store
        .write(&[
            goal("a", 1),
            goal("b", 2),
            Record::Answer("r1".into(), reply()),
            Record::Tree(None),
        ])
        .unwrap();
    store.write(&[Record::ForgetGoal("a".into())]).unwrap();
    let name = store.name().to_owned();
    drop(store);
    let again = MissionStore::open(&path, "r").unwrap();
    assert_eq!(again.name(), name);
    let second = again.begin_life().unwrap();
    assert_eq!(second.incarnation, 2);
    assert_eq!(
        second
            .goals
            .iter()
            .map(|goal| goal.state.id.as_str())
            .collect::<Vec<_>>(),
        ["b"]
    );
    assert_eq!(second.answers, [("r1".to_owned(), reply())]);
    assert_eq!((second.tree, second.motion), (None, None));
}

#[test]
fn a_standby_s_store_holds_what_the_leader_s_holds_but_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let open = |name: &str| MissionStore::open(&folder.path().join(name), "r").unwrap();
    let (leader, standby) = (open("leader"), open("standby"));
    standby.write(&[goal("stale", 1)]).unwrap();
    leader.begin_life().unwrap();
    leader.write(&[goal("a", 1), goal("b", 2)]).unwrap();
    let leadership = Leadership { epoch: 7, shared: true };
    standby
        .apply(&leader.everything().unwrap(), true, Some(leadership))
        .unwrap();
    let writes = leader.write(&[Record::ForgetGoal("a".into()), goal("c", 3)]).unwrap();
    standby.apply(&writes, false, None).unwrap();
    assert_eq!(standby.everything().unwrap(), leader.everything().unwrap());
    assert_eq!(
        (standby.leadership().unwrap(), leader.leadership().unwrap()),
        (leadership, Leadership::default())
    );
    assert_ne!(standby.name(), leader.name());
    assert_eq!(
        standby.begin_life().unwrap().incarnation,
        2,
        "its lives are newer than the leader's"
    );
    let stray = JournalWrite {
        table: "own".into(),
        key: "name".into(),
        value: Some("x".into()),
    };
    assert!(standby.apply(&[stray], true, None).is_err());
    assert_eq!(standby.goals().unwrap().len(), 2, "nothing of a bad batch is written");
}

#[test]
fn a_file_in_use_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    let _store = MissionStore::open(&path, "r").unwrap();
    assert!(matches!(MissionStore::open(&path, "r"), Err(StoreError::Locked { .. })));
}

#[test]
fn a_file_that_is_no_store_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    std::fs::write(&path, vec![7_u8; 10_000]).unwrap();
    assert!(matches!(MissionStore::open(&path, "r"), Err(StoreError::Io { .. })));
}

/// A store with three goals, closed.
fn three(path: &Path) {
    let store = MissionStore::open(path, "r").unwrap();
    store.begin_life().unwrap();
    store.write(&[goal("a", 1), goal("b", 2), goal("c", 3)]).unwrap();
    store
        .write(&[goal("b", 4), Record::Answer("r".into(), reply())])
        .unwrap();
    store.write(&[Record::ForgetAnswer("r".into())]).unwrap();
}

fn reply() -> GoalReply {
    GoalReply {
        robot: None,
        id: "a".into(),
        state: GoalPhase::Canceled,
        reason: None,
    }
}

fn refused(path: &Path) -> String {
    match MissionStore::open(path, "r") {
        Err(error @ StoreError::Foreign { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_emptied_file_is_not_taken_for_a_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    three(&path);
    std::fs::write(&path, b"").unwrap();
    let said = refused(&path);
    assert!(
        said.contains("mission.redb: an empty file") && said.contains("move the file away"),
        "{said}"
    );
    assert_eq!(std::fs::metadata(&path).unwrap().len(), 0, "it is left as it is");
    std::fs::remove_file(&path).unwrap();
    assert!(MissionStore::open(&path, "r").unwrap().goals().unwrap().is_empty());
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        1,
        "nothing lies beside it"
    );
}

#[test]
fn a_record_that_is_gone_added_or_changed_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    type Spoil = fn(&mut ::redb::Table<'_, &'static str, &'static [u8]>);
    let change = |spoil: Spoil| {
        let _ = std::fs::remove_file(&path);
        three(&path);
        let database = Database::open(&path).unwrap();
        let write = database.begin_write().unwrap();
        spoil(&mut write.open_table(definition(Table::Goals)).unwrap());
        write.commit().unwrap();
    };
    let changes: [Spoil; 3] = [
        |goals| drop(goals.remove("b").unwrap()),
        |goals| drop(goals.insert("d", b"{}".as_slice()).unwrap()),
        |goals| {
            let other = goals.get("a").unwrap().unwrap().value().to_vec();
            goals.insert("b", other.as_slice()).unwrap();
        },
    ];
    for made in changes {
        change(made);
        assert!(refused(&path).contains("checksum"));
    }
    change(|_| {});
    assert_eq!(MissionStore::open(&path, "r").unwrap().goals().unwrap().len(), 3);
}

#[test]
fn every_byte_that_is_spoilt_costs_no_goal_in_silence() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    three(&path);
    let whole = std::fs::read(&path).unwrap();
    let expected = {
        let store = MissionStore::open(&path, "r").unwrap();
        store.goals().unwrap()
    };
    // Every position of a goal's text in the file.
    let places: Vec<usize> = (0..whole.len() - 8)
        .filter(|at| whole[*at..].starts_with(b"accepted"))
        .collect();
    assert!(!places.is_empty());
    for at in places {
        let mut spoilt = whole.clone();
        spoilt[at] ^= 0x20;
        std::fs::write(&path, &spoilt).unwrap();
        match MissionStore::open(&path, "r").and_then(|store| store.goals()) {
            Ok(goals) => assert_eq!(goals, expected, "at {at}: an old copy, or all is well"),
            Err(error) => assert!(error.to_string().contains("mission.redb"), "{error}"),
        }
    }
}

#[test]
fn another_robot_s_file_is_refused_with_both_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    three(&path);
    let error = MissionStore::open(&path, "other").unwrap_err().to_string();
    assert!(error.contains("`r`") && error.contains("`other`"), "{error}");
}

#[test]
fn a_store_of_before_the_checksum_is_taken_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.redb");
    three(&path);
    let database = Database::open(&path).unwrap();
    let write = database.begin_write().unwrap();
    for key in [CHECKSUM, ROBOT] {
        write.open_table(definition(Table::Own)).unwrap().remove(key).unwrap();
    }
    write.commit().unwrap();
    drop(database);
    assert_eq!(MissionStore::open(&path, "r").unwrap().goals().unwrap().len(), 3);
    assert_eq!(MissionStore::open(&path, "r").unwrap().goals().unwrap().len(), 3);
}

/// What any engine promises.
fn keeps_its_promises(engine: &mut dyn Engine) {
    let change = |table, key: &str, value: Option<&[u8]>| Change {
        table,
        key: key.to_owned(),
        value: value.map(<[u8]>::to_vec),
    };
    for table in Table::ALL {
        assert_eq!((engine.get(table, "a"), engine.rows(table)), (Ok(None), Ok(Vec::new())));
    }
    // Keys in the order of their bytes, whatever a language's order is; any bytes as a value.
    let keys = ["", "B", "a", "a b", "a-1", "ab", "z", "ä\u{1F600}"];
    let rows = keys.map(|key| (key.to_owned(), [key.as_bytes(), &[0, 255]].concat()));
    let written = rows.iter().rev();
    let written: Vec<Change> = written
        .map(|(key, value)| change(Table::Goals, key, Some(value)))
        .collect();
    engine.commit(&written).unwrap();
    assert_eq!(engine.rows(Table::Goals), Ok(rows.to_vec()));
    assert_eq!(engine.rows(Table::Answers), Ok(Vec::new()), "tables are apart");
    let changes = [
        change(Table::Goals, "a", None),
        change(Table::Goals, "never", None),
        change(Table::Goals, "ab", Some(b"2")),
        change(Table::Own, "a", Some(b"")),
    ];
    engine.commit(&changes).unwrap();
    engine.reopen().unwrap();
    assert_eq!(engine.get(Table::Goals, "a"), Ok(None));
    assert_eq!(engine.get(Table::Goals, "ab"), Ok(Some(b"2".to_vec())));
    assert_eq!(
        engine.get(Table::Own, "a"),
        Ok(Some(Vec::new())),
        "nothing written is no missing record"
    );
    assert_eq!(engine.rows(Table::Goals).unwrap().len(), keys.len() - 1);
    engine.commit(&[]).unwrap();
}

#[test]
fn every_engine_keeps_its_promises() {
    let folder = tempfile::tempdir().unwrap();
    keeps_its_promises(&mut RedbFile::open(&folder.path().join("m"), &[]).unwrap());
    keeps_its_promises(&mut Memory::default());
}

/// The store in these tables, which another process may have had before.
fn over(memory: &Memory) -> MissionStore {
    MissionStore::over(Box::new(memory.clone()), "memory".to_owned(), "r").unwrap()
}

#[test]
fn what_did_not_find_room_is_not_there_and_the_store_goes_on_once_there_is_room() {
    let memory = Memory::default();
    let store = over(&memory);
    store.begin_life().unwrap();
    store.write(&[goal("a", 1)]).unwrap();
    let before = store.everything().unwrap();
    memory.set_full(true);
    let leadership = Leadership { epoch: 7, shared: true };
    let full = [
        store.write(&[goal("b", 2), Record::ForgetGoal("a".into())]).map(drop),
        store.apply(&[], true, Some(leadership)),
        store.begin_life().map(drop),
        store.try_to_write(),
    ];
    assert!(
        full.iter().all(|error| matches!(error, Err(StoreError::NoRoom { .. }))),
        "{full:?}"
    );
    memory.set_full(false);
    assert!(store.write(&[goal("b", 2)]).is_err(), "it is not open");
    store.reopen().unwrap();
    assert_eq!(
        (store.everything().unwrap(), store.leadership().unwrap()),
        (before, Leadership::default())
    );
    store.write(&[goal("b", 2)]).unwrap();
    assert_eq!(over(&memory).goals().unwrap().len(), 2, "its checksum fits");
}

/// What happens to a store.
#[derive(Clone, Debug)]
enum Step {
    /// A leader's writes: table, key, value.
    Apply(Vec<(usize, u8, Option<u8>)>, bool, Option<u64>),
    BeginLife,
    /// Its process ends, and another one begins.
    Restart,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    // Few keys, so that batches name a record twice.
    let write = (0..2_usize, 0..4_u8, proptest::option::of(0..3_u8));
    let apply = (
        proptest::collection::vec(write, 0..6),
        any::<bool>(),
        proptest::option::of(0..9_u64),
    );
    let step = prop_oneof![
        6 => apply.prop_map(|(writes, instead, epoch)| Step::Apply(writes, instead, epoch)),
        1 => Just(Step::BeginLife),
        1 => Just(Step::Restart),
    ];
    proptest::collection::vec(step, 1..12)
}

/// A store in a file, and one in memory.
struct Both {
    folder: TempDir,
    memory: Memory,
    stores: Option<[MissionStore; 2]>,
}

impl Both {
    fn restart(&mut self) -> &[MissionStore; 2] {
        drop(self.stores.take());
        let file = MissionStore::open(&self.folder.path().join("m"), "r").unwrap();
        self.stores.insert([file, over(&self.memory)])
    }

    fn take(&mut self, step: &Step) {
        let Some(stores) = self.stores.as_ref() else { return };
        match step {
            Step::Apply(writes, instead, epoch) => {
                let write = |&(table, key, value): &(usize, u8, Option<u8>)| JournalWrite {
                    table: [Table::Answers, Table::Singles][table].name().to_owned(),
                    key: format!("k{key}"),
                    value: value.map(|value| format!("{value}")),
                };
                let writes: Vec<JournalWrite> = writes.iter().map(write).collect();
                let leadership = epoch.map(|epoch| Leadership { epoch, shared: true });
                for store in stores {
                    store.apply(&writes, *instead, leadership).unwrap();
                }
            }
            Step::BeginLife => {
                // No answer: what these steps write is none.
                let lives = stores
                    .each_ref()
                    .map(|store| store.apply(&[], true, None).and_then(|()| store.begin_life()));
                let [file, memory] = lives.map(|life| life.unwrap().incarnation);
                assert_eq!(file, memory);
            }
            Step::Restart => {
                self.restart();
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_store_in_a_file_is_one_in_memory_that_survives_its_process(steps in steps()) {
        let mut both = Both { folder: tempfile::tempdir().unwrap(), memory: Memory::default(), stores: None };
        both.restart();
        for step in steps.iter().chain([&Step::Restart]) {
            both.take(step);
            let stores = both.stores.as_ref().unwrap().each_ref();
            let [file, memory] = stores.map(|store| (store.everything().unwrap(), store.leadership().unwrap()));
            prop_assert_eq!(file, memory);
        }
    }
}
