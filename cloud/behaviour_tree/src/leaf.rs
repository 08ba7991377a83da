//! External leaves and decorators. How does code outside the engine become a node? Through one trait for each.
//!
//! The engine has no clock, no I/O and no robot: a leaf gets the time and its ports through [`LeafIo`], and everything else through the
//! context `C` passed to the tick.
//!
//! # What survives a crash
//! A leaf object is constructed anew when a tree is restored. State that must survive (an execution id, a start time) is stored with
//! [`LeafIo::remember`], which is part of the tree's snapshot. A leaf with an external effect remembers it in `start` and acts in the next
//! `tick`, so that the caller can store the snapshot in between; then no effect is ever unknown after a restart.

use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::blackboard::{Blackboard, Slot, TypeError};
use super::node::{Info, Memory};
use super::ports::{PortError, Source};
use super::status::Status;
use super::value::{FromValue, Value};
use super::xml::shortened;

/// An action or a condition.
///
/// ```
/// use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Registry, Status, build};
///
/// struct Count;
/// impl Leaf<u32> for Count {
///     fn start(&mut self, io: &mut LeafIo<'_>, total: &mut u32) -> Status {
///         let Ok(step) = io.get::<u64>("step") else { return io.fail("no step") };
///         *total += step as u32;
///         Status::Success
///     }
/// }
///
/// let mut registry = Registry::new();
/// registry
///     .leaf(
///         NodeSpec::action("Count", "Adds to a total.").input_or("step", PortType::Unsigned, "1", "by how much"),
///         |_| Box::new(Count),
///     )
///     .unwrap();
/// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
///     <Sequence><Count step="40"/><Count step="2"/></Sequence>
/// </BehaviorTree></root>"#;
/// let mut tree = build("count.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into())).unwrap();
/// let mut total = 0;
/// assert_eq!(tree.tick(std::time::Duration::ZERO, &mut total).unwrap(), Status::Success);
/// assert_eq!(total, 42);
/// ```
pub trait Leaf<C>: Send {
    /// Called on entry from any status but `Running`. Answers `Running` to be ticked again.
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut C) -> Status;

    /// Called on every later tick while `Running`. By default, calls `start` again, which suits a condition.
    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut C) -> Status {
        self.start(io, ctx)
    }

    /// Called instead of `tick` in the first tick after a restart, if this leaf was `Running`.
    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut C) -> Status {
        self.tick(io, ctx)
    }

    /// Called exactly once if the leaf is stopped while `Running`, never otherwise: not if it has completed and a script after it fails.
    fn halt(&mut self, _io: &mut LeafIo<'_>, _ctx: &mut C) {}
}

/// What an external decorator does with its child in this tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Enter {
    /// Tick the child, then call [`Decorator::leave`].
    TickChild,
    /// Do not tick the child; give this answer.
    Answer(Status),
}

impl Enter {
    /// Ticks the child if it is due, else answers `Running`.
    pub fn child_if(due: bool) -> Enter {
        if due {
            Enter::TickChild
        } else {
            Enter::Answer(Status::Running)
        }
    }
}

/// A decorator that needs the context, such as for ticking by distance or speed, or for goal updates.
pub trait Decorator<C>: Send {
    /// Called before the child might be ticked. `child` is the child's status; `Running` means that it was not finished in its last tick.
    fn enter(&mut self, io: &mut LeafIo<'_>, ctx: &mut C, child: Status) -> Enter;

    /// Called with the child's answer; the return value is the decorator's answer.
    fn leave(&mut self, _io: &mut LeafIo<'_>, _ctx: &mut C, child: Status) -> Status {
        child
    }

    /// Called exactly once if the decorator is stopped while `Running`, or by an error while it ticks its child; after its child.
    fn halt(&mut self, _io: &mut LeafIo<'_>, _ctx: &mut C) {}
}

/// A leaf's view of the tree: time, its ports, its name, its memory.
pub struct LeafIo<'a> {
    pub(crate) info: &'a Info,
    pub(crate) uid: u16,
    pub(crate) now: Duration,
    pub(crate) previous: Status,
    pub(crate) board: &'a mut Blackboard,
    pub(crate) memory: &'a mut Memory,
    pub(crate) wake: &'a mut bool,
    pub(crate) abort: Option<String>,
}

impl LeafIo<'_> {
    /// Time of this tick, since the epoch of the tick times.
    pub fn now(&self) -> Duration {
        self.now
    }

    /// The node's number: its position in document order, from 1.
    pub fn uid(&self) -> u16 {
        self.uid
    }

    /// The node's `name` in the tree file; its registration id if it has none.
    pub fn name(&self) -> &str {
        &self.info.name
    }

    /// The node's registration id.
    pub fn id(&self) -> &str {
        &self.info.id
    }

    /// The node's status before this tick. `Idle` means that the parent has reset it since: a condition that compares with its activation
    /// takes its sample then.
    pub fn previous(&self) -> Status {
        self.previous
    }

    /// Reads a port as `T`, through remapping, literal or default.
    ///
    /// # Errors
    /// [`PortError`]: not set, entry never written, or of another type.
    ///
    /// ```
    /// # use std::time::Duration;
    /// use zenav_behaviour_tree::{NodeSpec, PortType, Registry, Status, build};
    ///
    /// let mut registry = Registry::<()>::new();
    /// let spec = NodeSpec::condition("IsNear", "SUCCESS within 0.5 m.").input("distance", PortType::Double, "m");
    /// registry.function(spec, |io, _| match io.get::<f64>("distance") {
    ///     Ok(distance) => Status::from_truth(distance < 0.5),
    ///     Err(wrong) => io.fail(wrong.to_string()),
    /// })?;
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><IsNear distance="{left}"/></BehaviorTree></root>"#;
    /// # let mut tree = build("near.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()))?;
    /// assert_eq!(tree.tick(Duration::ZERO, &mut ())?, Status::Failure);
    /// assert_eq!(tree.report()[0].feedback, "the blackboard entry behind port `distance` has no value yet");
    /// tree.blackboard_mut().set("left", 0.3)?;
    /// assert_eq!(tree.tick(Duration::ZERO, &mut ())?, Status::Success);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn get<T: FromValue>(&self, port: &str) -> Result<T, PortError> {
        let value = self.value(port)?;
        T::from_value(value).ok_or_else(|| unfit(port, value, T::EXPECTED))
    }

    /// Reads a port if it is set and its entry has been written: `None` otherwise.
    ///
    /// # Errors
    /// [`PortError::Type`] alone.
    pub fn get_optional<T: FromValue>(&self, port: &str) -> Result<Option<T>, PortError> {
        match self.get(port) {
            Ok(value) => Ok(Some(value)),
            Err(PortError::Unset(_) | PortError::Empty(_)) => Ok(None),
            Err(wrong) => Err(wrong),
        }
    }

    /// The number on a port, or another one if the port is not set or its entry has no value.
    ///
    /// # Errors
    /// [`PortError::Type`].
    pub fn number_or(&self, port: &str, otherwise: f64) -> Result<f64, PortError> {
        Ok(self.get_optional(port)?.unwrap_or(otherwise))
    }

    /// Reads structured data; text is parsed as JSON.
    ///
    /// # Errors
    /// [`PortError`]: not set, entry never written, or of another shape.
    pub fn get_data<T: DeserializeOwned>(&self, port: &str) -> Result<T, PortError> {
        let value = self.value(port)?;
        let wrong = |why: serde_json::Error| unfit(port, value, why);
        match value {
            Value::Data(data) => T::deserialize(&**data).map_err(wrong),
            Value::Text(text) => serde_json::from_str(text.strip_prefix("json:").unwrap_or(text)).map_err(wrong),
            scalar => T::deserialize(scalar.to_json()).map_err(wrong),
        }
    }

    /// The value on a port.
    ///
    /// # Errors
    /// [`PortError`]: not set, or entry never written.
    pub fn value(&self, port: &str) -> Result<&Value, PortError> {
        match self.source(port) {
            Some(Source::Literal(value)) => Ok(value),
            Some(Source::Slot(slot)) => self.board.read(*slot).ok_or_else(|| PortError::Empty(port.to_owned())),
            Some(Source::Unset) | None => Err(PortError::Unset(port.to_owned())),
        }
    }

    /// How often the entry behind a port has been written: changes with every write, also of an equal value. 0 for a literal.
    pub fn sequence(&self, port: &str) -> u64 {
        match self.source(port) {
            Some(Source::Slot(slot)) => self.board.sequence(*slot),
            _ => 0,
        }
    }

    /// Names of the ports that the tree or a default has set, in the order of the specification, then of the file.
    pub fn ports(&self) -> impl Iterator<Item = &str> {
        self.info.ports.iter().map(|bound| &*bound.name)
    }

    /// Whether the port leads to an entry, which the leaf may write.
    pub fn is_writable(&self, port: &str) -> bool {
        matches!(self.source(port), Some(Source::Slot(_)))
    }

    /// Whether the tree or a default has set this port.
    pub fn is_set(&self, port: &str) -> bool {
        matches!(self.source(port), Some(Source::Literal(_) | Source::Slot(_)))
    }

    /// Writes an output port; the value is converted to the port's type. If the tree does not set the port, the value is discarded.
    ///
    /// # Errors
    /// [`PortError::Type`] if the entry behind it has another type, [`PortError::Literal`].
    ///
    /// ```
    /// # use std::time::Duration;
    /// use zenav_behaviour_tree::{NodeSpec, PortType, Registry, Status, Value, build};
    ///
    /// let mut registry = Registry::<()>::new();
    /// let spec = NodeSpec::action("Measure", "Measures the tank.").output("level", PortType::Double, "from 0 to 1");
    /// registry.function(spec, |io, _| match io.set("level", 0.75) {
    ///     Ok(()) => Status::Success,
    ///     Err(wrong) => io.fail(wrong.to_string()),
    /// })?;
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Measure level="{tank}"/></BehaviorTree></root>"#;
    /// # let mut tree = build("tank.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()))?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// assert_eq!(tree.blackboard().get("tank"), Some(&Value::Double(0.75)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set(&mut self, port: &str, value: impl Into<Value>) -> Result<(), PortError> {
        self.write(port, value.into(), Blackboard::write)
    }

    /// As [`LeafIo::set`], for feedback that is recomputed after a restart: does not invalidate a stored snapshot.
    ///
    /// # Errors
    /// As [`LeafIo::set`].
    pub fn set_fleeting(&mut self, port: &str, value: impl Into<Value>) -> Result<(), PortError> {
        self.write(port, value.into(), Blackboard::write_fleeting)
    }

    fn write(
        &mut self,
        port: &str,
        value: Value,
        write: fn(&mut Blackboard, Slot, Value) -> Result<(), TypeError>,
    ) -> Result<(), PortError> {
        let Some(bound) = self.info.ports.iter().find(|bound| &*bound.name == port) else {
            return Ok(());
        };
        let slot = match &bound.source {
            Source::Unset => return Ok(()),
            Source::Literal(_) => return Err(PortError::Literal(port.to_owned())),
            Source::Slot(slot) => *slot,
        };
        let value = match bound.kind.value_type() {
            Some(kind) if kind != value.kind() => match value.convert(kind) {
                Some(converted) => converted,
                None => return Err(unfit(port, &value, bound.kind.expected())),
            },
            _ => value,
        };
        write(self.board, slot, value).map_err(|wrong| {
            let expected = format!("{:?}, the type of its entry", wrong.expected);
            unfit(port, &wrong.value, expected)
        })
    }

    /// Reads a blackboard entry by its name in the scope of this node (`goal`, `@goal`). Ports are preferable; some Nav2 nodes fall back to
    /// fixed names.
    pub fn entry(&self, key: &str) -> Option<&Value> {
        self.board
            .find(self.info.scope, key)
            .and_then(|slot| self.board.read(slot))
    }

    /// Writes a blackboard entry by its name in the scope of this node.
    ///
    /// # Errors
    /// [`super::TypeError`] if the entry has another type.
    pub fn set_entry(&mut self, key: &str, value: impl Into<Value>) -> Result<(), super::TypeError> {
        let slot = self.board.resolve(self.info.scope, key);
        self.board.write(slot, value.into())
    }

    /// Sets the node's feedback text; kept until its next start.
    pub fn say(&mut self, feedback: impl Into<String>) {
        self.memory.feedback = feedback.into();
    }

    /// Sets the feedback and fails: `return io.fail("no path")`.
    pub fn fail(&mut self, why: impl Into<String>) -> Status {
        self.say(why);
        Status::Failure
    }

    /// Ends the whole tree with an error, for failures that no recovery in the tree can fix.
    pub fn abort(&mut self, why: impl Into<String>) -> Status {
        let why = why.into();
        self.memory.feedback.clone_from(&why);
        self.abort = Some(why);
        Status::Failure
    }

    /// What the node has remembered; `None` before it remembers anything, or if the stored value has another form. Survives success,
    /// failure and halt.
    pub fn recall<T: DeserializeOwned>(&self) -> Option<T> {
        T::deserialize(&self.memory.kept).ok()
    }

    /// Stores a value in the tree's snapshot for this node.
    ///
    /// # Errors
    /// serde_json's error for values that JSON cannot represent.
    ///
    /// ```
    /// # use std::time::Duration;
    /// use zenav_behaviour_tree::{NodeSpec, Registry, Status, build};
    ///
    /// let mut registry = Registry::<()>::new();
    /// registry.function(NodeSpec::action("Thrice", "SUCCESS in the third tick."), |io, _| {
    ///     let ticks = io.recall::<u32>().unwrap_or(0) + 1;
    ///     match io.remember(&ticks) {
    ///         Ok(()) if ticks < 3 => Status::Running,
    ///         Ok(()) => Status::Success,
    ///         Err(wrong) => io.fail(wrong.to_string()),
    ///     }
    /// })?;
    /// # let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Thrice/></BehaviorTree></root>"#;
    /// # let make = || build("thrice.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()));
    /// # let (mut tree, mut restarted) = (make()?, make()?);
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// restarted.restore(tree.snapshot())?;
    /// assert_eq!(restarted.tick(Duration::ZERO, &mut ())?, Status::Success);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn remember<T: Serialize>(&mut self, what: &T) -> Result<(), serde_json::Error> {
        let kept = serde_json::to_value(what)?;
        if kept != self.memory.kept {
            self.memory.kept = kept;
            self.memory.writes += 1;
        }
        Ok(())
    }

    /// Requests another tick at once, without waiting for the next period.
    pub fn wake(&mut self) {
        *self.wake = true;
    }

    fn source(&self, port: &str) -> Option<&Source> {
        self.info
            .ports
            .iter()
            .find(|bound| &*bound.name == port)
            .map(|bound| &bound.source)
    }
}

/// Error for an unsuitable value; the message quotes at most 60 characters of it.
fn unfit(port: &str, value: &Value, expected: impl ToString) -> PortError {
    PortError::Type {
        port: port.to_owned(),
        value: shortened(&value.to_string(), 60),
        expected: expected.to_string(),
    }
}

/// A leaf consisting of a function.
pub(crate) struct FnLeaf<F>(pub(crate) F);

impl<C, F: FnMut(&mut LeafIo<'_>, &mut C) -> Status + Send> Leaf<C> for FnLeaf<F> {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut C) -> Status {
        (self.0)(io, ctx)
    }
}
