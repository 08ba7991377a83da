//! Text. States of the real code are compared by their `Debug` text, which has every field.

use std::fmt::{Debug, Formatter, Result, Write};
use std::hash::{Hash, Hasher};
use std::ops::{Deref, DerefMut};

/// A value that is compared and hashed by its `Debug` text, for types whose fields are floats or trait objects.
#[derive(Clone, Default)]
pub struct Text<T>(pub T);

/// Writes text into a hasher, without a copy.
struct Sink<'a, H>(&'a mut H);

impl<H: Hasher> Write for Sink<'_, H> {
    fn write_str(&mut self, text: &str) -> Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

impl<T: Debug> Hash for Text<T> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // No `Debug` of the workspace fails, and neither does this sink.
        let _ = write!(Sink(state), "{:?}", self.0);
        state.write_u8(0);
    }
}

impl<T: Debug> PartialEq for Text<T> {
    fn eq(&self, other: &Self) -> bool {
        format!("{:?}", self.0) == format!("{:?}", other.0)
    }
}

impl<T: Debug> Debug for Text<T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        self.0.fmt(f)
    }
}

impl<T> Deref for Text<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T> DerefMut for Text<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.0
    }
}
