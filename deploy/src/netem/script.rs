//! Script. Text form of a link's impairments over time.
//!
//! One change per line: time, name, value. `#` starts a comment.
//!
//! ```text
//! 0s   delay  80ms
//! 10s  rate   256kbit
//! 20s  stall  500ms/10s     # for half a second, every ten on average
//! 25s  loss   5%            # of the datagrams
//! 30s  cut    5s
//! 45s  reset                # every connection is closed
//! 60s  delay  0ms
//! ```

use std::time::Duration;

use super::link::{Change, Cut, Impairment};

/// Impairments of a link over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    pub(super) changes: Vec<Change>,
    pub(super) cuts: Vec<Cut>,
    /// Times at which every connection is closed, or forgotten.
    pub(super) resets: Vec<Duration>,
}

impl Script {
    /// A link that starts with this impairment.
    pub(super) fn from_start(to: Impairment) -> Self {
        Self {
            changes: vec![Change { at: Duration::ZERO, to }],
            ..Self::default()
        }
    }

    /// Adds the changes of a script's text.
    ///
    /// # Errors
    /// The line, and what was expected there.
    pub fn read(&mut self, text: &str) -> Result<(), String> {
        for (number, line) in (1_usize..).zip(text.lines()) {
            let line = line.split('#').next().unwrap_or_default();
            let words: Vec<&str> = line.split_whitespace().collect();
            if !words.is_empty() {
                self.add(&words).map_err(|error| format!("line {number}: {error}"))?;
            }
        }
        Ok(())
    }

    /// Whether it loses datagrams at any time.
    pub(super) fn loses(&self) -> bool {
        self.changes.iter().any(|change| change.to.loss > 0.0)
    }

    fn add(&mut self, words: &[&str]) -> Result<(), String> {
        let (at, name, value) = match words {
            [at, name] => (duration(at)?, *name, None),
            [at, name, value] => (duration(at)?, *name, Some(*value)),
            _ => return Err("expected a time, a name and a value, such as `10s delay 80ms`".to_owned()),
        };
        let value = |what: &str| value.ok_or_else(|| format!("`{name}`: expected {what} behind it"));
        let last = self.changes.last().copied().unwrap_or(Change {
            at: Duration::ZERO,
            to: Impairment::default(),
        });
        let mut to = last.to;
        match name {
            "delay" => to.delay = duration(value("a time, such as 80ms")?)?,
            "jitter" => to.jitter = duration(value("a time, such as 20ms")?)?,
            "rate" => to.rate = rate(value("a rate, such as 256kbit, or `none`")?)?,
            "stall" => (to.stall, to.every) = stall(value("two times, such as 500ms/10s, or `none`")?)?,
            "loss" => to.loss = loss(value("a share, such as 5%")?)?,
            "cut" => {
                let lasts = duration(value("a time, such as 5s")?)?;
                self.cuts.push(Cut { at, lasts });
                return Ok(());
            }
            "reset" => {
                self.resets.push(at);
                return Ok(());
            }
            _ => {
                return Err(format!(
                    "`{name}`: expected delay, jitter, rate, stall, loss, cut or reset"
                ));
            }
        }
        if at < last.at {
            return Err(format!(
                "`{name}`: expected a time that is no earlier than the one before"
            ));
        }
        self.changes.push(Change { at, to });
        Ok(())
    }
}

/// A time: a number and its unit.
///
/// # Errors
/// What was expected.
pub(super) fn duration(text: &str) -> Result<Duration, String> {
    let expected = || format!("`{text}`: expected a time with its unit, such as 80ms, 1.5s or 2min");
    let split = text.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(expected)?;
    let (number, unit) = text.split_at(split);
    let secs = match unit {
        "us" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        "min" => 60.0,
        _ => return Err(expected()),
    };
    let number: f64 = number.parse().map_err(|_| expected())?;
    let longest = 1e7;
    if (0.0..=longest).contains(&(number * secs)) {
        Ok(Duration::from_secs_f64(number * secs))
    } else {
        Err(expected())
    }
}

/// A rate in bytes per second; `none` is unlimited.
///
/// # Errors
/// What was expected.
pub(super) fn rate(text: &str) -> Result<Option<f64>, String> {
    if text == "none" {
        return Ok(None);
    }
    let expected = || format!("`{text}`: expected bits a second, such as 256kbit or 10mbit, or `none`");
    let split = text.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(expected)?;
    let (number, unit) = text.split_at(split);
    let bits = match unit {
        "bit" => 1.0,
        "kbit" => 1e3,
        "mbit" => 1e6,
        "gbit" => 1e9,
        _ => return Err(expected()),
    };
    let number: f64 = number.parse().map_err(|_| expected())?;
    let bytes = number * bits / 8.0;
    if bytes.is_finite() && bytes >= 1.0 {
        Ok(Some(bytes))
    } else {
        Err(expected())
    }
}

/// A share, 0 to 1: a number of percent.
///
/// # Errors
/// What was expected.
pub(super) fn loss(text: &str) -> Result<f64, String> {
    let percent = text.strip_suffix('%').and_then(|number| number.parse::<f64>().ok());
    let share = percent.filter(|percent| (0.0..=100.0).contains(percent));
    share
        .map(|percent| percent / 100.0)
        .ok_or_else(|| format!("`{text}`: expected a share of the datagrams, such as 5%"))
}

/// Length of a stall, and mean time between stalls; `none` for no stalls.
///
/// # Errors
/// What was expected.
pub(super) fn stall(text: &str) -> Result<(Duration, Option<Duration>), String> {
    if text == "none" {
        return Ok((Duration::ZERO, None));
    }
    let expected = || format!("`{text}`: expected how long and how often, such as 500ms/10s, or `none`");
    let (lasts, every) = text.split_once('/').ok_or_else(expected)?;
    let every = duration(every)?;
    if every.is_zero() {
        return Err(expected());
    }
    Ok((duration(lasts)?, Some(every)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_is_read_line_by_line() {
        let mut script = Script::from_start(Impairment::default());
        let text = "# a link\n0s delay 80ms\n10s rate 256kbit\n20s stall 500ms/10s # now and then\n25s loss 5%\n30s cut 5s\n45s reset\n1min delay 0ms\n";
        script.read(text).unwrap();
        let last = script.changes.last().unwrap();
        assert_eq!((script.changes.len(), last.at), (6, Duration::from_secs(60)));
        assert_eq!((last.to.delay, last.to.rate), (Duration::ZERO, Some(32_000.0)));
        assert!((last.to.loss - 0.05).abs() < 1e-12);
        assert_eq!(last.to.every, Some(Duration::from_secs(10)));
        assert_eq!(script.cuts.len() + script.resets.len(), 2);
    }

    #[test]
    fn a_mistake_is_told_with_its_line_and_what_was_expected() {
        for (text, told) in [
            ("\n10 delay 80ms", "line 2: `10`: expected a time with its unit"),
            ("10s delay", "line 1: `delay`: expected a time, such as 80ms behind it"),
            ("10s rate 5", "`5`: expected bits a second"),
            ("10s loss 5", "`5`: expected a share of the datagrams, such as 5%"),
            ("10s loss 105%", "`105%`: expected a share"),
            (
                "10s lose 5%",
                "`lose`: expected delay, jitter, rate, stall, loss, cut or reset",
            ),
            (
                "10s delay 1ms\n5s delay 2ms",
                "line 2: `delay`: expected a time that is no earlier",
            ),
            ("1s stall 5s/0s", "expected how long and how often"),
            ("nans delay 1s", "expected a time"),
            ("1s delay -5ms", "expected a time"),
        ] {
            let error = Script::default().read(text).unwrap_err();
            assert!(error.contains(told), "{text:?}: {error}");
        }
    }
}
