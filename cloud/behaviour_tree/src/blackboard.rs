//! Blackboard. How do nodes exchange values? Through typed entries in scopes, one scope per SubTree.
//!
//! Names are resolved to slots when the tree is built, so a tick reads and writes by index. A SubTree sees its own names, those remapped to
//! its parent (`inner="{outer}"`, or all non-private ones under `_autoremap`), and those of the root with a leading `@` (BehaviorTree.CPP
//! v4).

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::value::{Value, ValueType};

/// Index of an entry, constant for the life of a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Slot(u32);

impl Slot {
    pub(crate) fn index(self) -> u32 {
        self.0
    }
}

/// Index of a scope; 0 is the root's.
pub(crate) type ScopeId = u32;

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Entry {
    value: Option<Value>,
    kind: Option<ValueType>,
    sequence: u64,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Scope {
    name: String,
    parent: Option<ScopeId>,
    autoremap: bool,
    keys: BTreeMap<String, Slot>,
}

/// A value whose type differs from the one that the entry has kept since its first assignment.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("entry holds {expected:?}, and {value} does not convert to it")]
pub struct TypeError {
    /// Type of the entry.
    pub expected: ValueType,
    /// The value that was not written.
    pub value: Value,
}

/// The entries of a whole tree.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Blackboard {
    entries: Vec<Entry>,
    scopes: Vec<Scope>,
    writes: u64,
    /// Entries named by ports; a property of the tree, not of a snapshot.
    #[serde(skip)]
    declared: BTreeSet<u32>,
}

impl PartialEq for Blackboard {
    fn eq(&self, other: &Self) -> bool {
        (&self.entries, &self.scopes, self.writes) == (&other.entries, &other.scopes, other.writes)
    }
}

impl Default for Blackboard {
    fn default() -> Self {
        Blackboard {
            entries: Vec::new(),
            scopes: vec![Scope::default()],
            writes: 0,
            declared: BTreeSet::new(),
        }
    }
}

impl Blackboard {
    /// Writes an entry of the root scope, creating it if necessary.
    ///
    /// # Errors
    /// [`TypeError`] if the entry has another type and the value does not convert without loss.
    ///
    /// ```
    /// use zenav_behaviour_tree::{Blackboard, Value};
    ///
    /// let mut board = Blackboard::default();
    /// board.set("speed", 0.5)?;
    /// board.set("speed", "0.8")?; // text is read as the entry's type
    /// assert_eq!(board.get("speed"), Some(&Value::Double(0.8)));
    /// assert!(board.set("speed", "fast").is_err());
    /// # Ok::<(), zenav_behaviour_tree::TypeError>(())
    /// ```
    pub fn set(&mut self, key: &str, value: impl Into<Value>) -> Result<(), TypeError> {
        let slot = self.resolve(0, key);
        self.write(slot, value.into())
    }

    /// Reads an entry of the root scope.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.find(0, key).and_then(|slot| self.read(slot))
    }

    /// Removes the value and type of an entry, root scope.
    pub fn unset(&mut self, key: &str) {
        if let Some(slot) = self.find(0, key) {
            self.clear(slot);
        }
    }

    /// Every entry with a value, as (scope, key, value), with scopes in document order and keys sorted. A remapped key appears once in
    /// every scope that has its own name for it.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str, &Value)> {
        self.scopes.iter().flat_map(move |scope| {
            scope
                .keys
                .iter()
                .filter_map(move |(key, slot)| Some((scope.name.as_str(), key.as_str(), self.read(*slot)?)))
        })
    }

    /// Number of writes that changed an entry: snapshots with the same count hold the same entries.
    pub fn writes(&self) -> u64 {
        self.writes
    }

    pub(crate) fn add_scope(&mut self, name: String, parent: ScopeId, autoremap: bool) -> ScopeId {
        self.scopes.push(Scope {
            name,
            parent: Some(parent),
            autoremap,
            keys: BTreeMap::new(),
        });
        (self.scopes.len() - 1) as ScopeId
    }

    /// Makes `key` of `scope` another name of `slot`.
    pub(crate) fn alias(&mut self, scope: ScopeId, key: &str, slot: Slot) {
        if let Some(scope) = self.scopes.get_mut(scope as usize) {
            scope.keys.insert(key.to_owned(), slot);
        }
    }

    /// Where `key` leads from `scope`: the owning scope, the name there, and its slot if it exists.
    fn locate<'k>(&self, mut scope: ScopeId, key: &'k str) -> (ScopeId, &'k str, Option<Slot>) {
        let key = match key.strip_prefix('@') {
            Some(root_key) => {
                scope = 0;
                root_key
            }
            None => key,
        };
        loop {
            let Some(here) = self.scopes.get(scope as usize) else {
                return (0, key, None);
            };
            if let Some(slot) = here.keys.get(key) {
                return (scope, key, Some(*slot));
            }
            match here.parent {
                // Parents come before their children, so this loop ends.
                Some(parent) if here.autoremap && !key.starts_with('_') && parent < scope => {
                    scope = parent;
                }
                _ => return (scope, key, None),
            }
        }
    }

    /// The slot of `key` in `scope`, if it exists.
    pub(crate) fn find(&self, scope: ScopeId, key: &str) -> Option<Slot> {
        self.locate(scope, key).2
    }

    /// The slot of `key` in `scope`, created if necessary.
    pub(crate) fn resolve(&mut self, scope: ScopeId, key: &str) -> Slot {
        let (owner, key, found) = self.locate(scope, key);
        found.unwrap_or_else(|| self.add_entry(owner, key))
    }

    /// Creates an entry in `scope` itself, regardless of remapping.
    pub(crate) fn add_entry(&mut self, scope: ScopeId, key: &str) -> Slot {
        let slot = Slot(self.entries.len() as u32);
        self.entries.push(Entry::default());
        self.alias(scope, key, slot);
        slot
    }

    pub(crate) fn read(&self, slot: Slot) -> Option<&Value> {
        self.entries.get(slot.0 as usize).and_then(|entry| entry.value.as_ref())
    }

    /// How often the entry has been written; 0 if never.
    pub(crate) fn sequence(&self, slot: Slot) -> u64 {
        self.entries.get(slot.0 as usize).map_or(0, |entry| entry.sequence)
    }

    /// The type of the entry, once it has one.
    pub(crate) fn kind(&self, slot: Slot) -> Option<ValueType> {
        self.entries.get(slot.0 as usize).and_then(|entry| entry.kind)
    }

    pub(crate) fn write(&mut self, slot: Slot, value: Value) -> Result<(), TypeError> {
        let Some(entry) = self.entries.get_mut(slot.0 as usize) else {
            return Ok(());
        };
        let value = match entry.kind {
            Some(kind) if kind != value.kind() => match value.convert(kind) {
                Some(converted) => converted,
                None => return Err(TypeError { expected: kind, value }),
            },
            _ => value,
        };
        entry.sequence += 1;
        // Repeated writes of an equal value, such as a selector's choice, do not invalidate a stored snapshot.
        if entry.kind.is_none() || entry.value.as_ref() != Some(&value) {
            entry.kind = Some(value.kind());
            entry.value = Some(value);
            self.writes += 1;
        }
        Ok(())
    }

    /// Writes a value that is recomputed after a restart: counts as an update of the entry, but does not invalidate a stored snapshot.
    pub(crate) fn write_fleeting(&mut self, slot: Slot, value: Value) -> Result<(), TypeError> {
        let writes = self.writes;
        self.write(slot, value)?;
        self.writes = writes;
        Ok(())
    }

    /// Marks an entry as named by a port: scripts may assign to it before it has a value.
    pub(crate) fn declare(&mut self, slot: Slot) {
        self.declared.insert(slot.0);
    }

    pub(crate) fn is_declared(&self, slot: Slot) -> bool {
        self.declared.contains(&slot.0)
    }

    /// Restores the entries stored for the same tree.
    pub(crate) fn restore(&mut self, stored: Self) {
        let declared = std::mem::take(&mut self.declared);
        *self = Self { declared, ..stored };
    }

    /// Writes a literal from a remapping: as a number if all of it is one, so that scripts can compute with it, otherwise as text. The
    /// first proper assignment determines its type.
    pub(crate) fn write_constant(&mut self, slot: Slot, text: &str) {
        let is_number = !text.is_empty()
            && text
                .bytes()
                .all(|byte| byte.is_ascii_digit() || b"+-.eE".contains(&byte));
        let number = || match text.parse::<i64>() {
            Ok(number) => Some(Value::Int(number)),
            Err(_) => text
                .parse()
                .ok()
                .filter(|number: &f64| number.is_finite())
                .map(Value::Double),
        };
        let value = is_number.then(number).flatten();
        self.write_untyped(slot, value.unwrap_or_else(|| Value::text(text)));
    }

    /// Writes text whose type is determined by the first proper assignment.
    pub(crate) fn write_literal(&mut self, slot: Slot, text: &str) {
        self.write_untyped(slot, Value::text(text));
    }

    fn write_untyped(&mut self, slot: Slot, value: Value) {
        if self.write(slot, value).is_ok()
            && let Some(entry) = self.entries.get_mut(slot.0 as usize)
        {
            entry.kind = None;
        }
    }

    /// Takes the first item of a list without counting as an update: a queue is consumed, not set.
    pub(crate) fn pop_front(&mut self, slot: Slot) -> Option<serde_json::Value> {
        let entry = self.entries.get_mut(slot.0 as usize)?;
        let Some(Value::Data(data)) = &mut entry.value else {
            return None;
        };
        if data.as_array().is_none_or(Vec::is_empty) {
            return None;
        }
        self.writes += 1;
        match std::sync::Arc::make_mut(data) {
            serde_json::Value::Array(items) => Some(items.remove(0)),
            _ => None,
        }
    }

    pub(crate) fn clear(&mut self, slot: Slot) {
        if let Some(entry) = self.entries.get_mut(slot.0 as usize) {
            entry.value = None;
            entry.kind = None;
            entry.sequence += 1;
            self.writes += 1;
        }
    }

    /// Whether every slot of `self` has the same meaning in `other`, so that a tree built over `self` can continue with `other`.
    pub(crate) fn is_extended_by(&self, other: &Blackboard) -> bool {
        let inside = |slot: &Slot| (slot.0 as usize) < other.entries.len();
        self.scopes.len() == other.scopes.len()
            && other.scopes.iter().all(|scope| scope.keys.values().all(inside))
            && self.scopes.iter().zip(&other.scopes).all(|(ours, theirs)| {
                ours.parent == theirs.parent
                    && ours.autoremap == theirs.autoremap
                    && ours.keys.iter().all(|(key, slot)| theirs.keys.get(key) == Some(slot))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_keeps_the_type_of_its_first_assignment() {
        let mut board = Blackboard::default();
        board.set("code", 1_i64).unwrap();
        board.set("code", "106").unwrap();
        assert_eq!(board.get("code"), Some(&Value::Int(106)));
        assert_eq!(board.set("code", "lost").unwrap_err().expected, ValueType::Int);
        assert_eq!(board.set("code", 2.5).unwrap_err().expected, ValueType::Int);
        board.unset("code");
        board.set("code", "free again").unwrap();
    }

    #[test]
    fn every_write_counts_even_of_the_same_value() {
        let mut board = Blackboard::default();
        let slot = board.resolve(0, "goal");
        assert_eq!(board.sequence(slot), 0);
        board.set("goal", 1_i64).unwrap();
        board.set("goal", 1_i64).unwrap();
        assert_eq!(board.sequence(slot), 2);
    }

    #[test]
    fn a_subtree_sees_only_what_is_remapped() {
        let mut board = Blackboard::default();
        board.set("goal", 1_i64).unwrap();
        let closed = board.add_scope("closed".into(), 0, false);
        let open = board.add_scope("open".into(), 0, true);
        assert_eq!(board.find(closed, "goal"), None);
        assert_eq!(board.find(closed, "@goal"), board.find(0, "goal"));
        assert_eq!(board.find(open, "goal"), board.find(0, "goal"));
        let private = board.resolve(open, "_goal");
        assert_eq!(board.find(0, "_goal"), None);
        assert_eq!(board.find(open, "_goal"), Some(private));
        let outer = board.resolve(0, "target");
        board.alias(closed, "goal", outer);
        assert_eq!(board.find(closed, "goal"), Some(outer));
    }

    #[test]
    fn a_key_first_named_in_an_autoremapped_subtree_belongs_to_the_parent() {
        let mut board = Blackboard::default();
        let open = board.add_scope("open".into(), 0, true);
        let slot = board.resolve(open, "fresh");
        assert_eq!(board.find(0, "fresh"), Some(slot));
    }
}
