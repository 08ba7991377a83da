//! Fault tables. The sensor faults of a world file.

use toml::Spanned;
use zenav_protocol::config_text::Number;
use zenav_protocol::id::Id;

use super::tables::{FaultName, FaultTable};
use crate::faults::{FaultKind, FaultModel};
use crate::world_check::{Source, WorldError};

/// Largest delay of readings, s.
const MAX_LATE: f64 = 10.0;
/// Largest additional noise, in the sensor's own unit.
const MAX_NOISE: f64 = 1000.0;

/// A fault of a sensor in its window of time.
pub(super) fn fault(source: Source<'_>, table: &Spanned<FaultTable>) -> Result<FaultModel, WorldError> {
    let FaultTable {
        robot,
        sensor,
        kind,
        amount,
        from,
        until,
    } = table.get_ref();
    let robot = match robot {
        None => None,
        Some(written) => match Id::robot(written.get_ref().as_str()) {
            Ok(robot) => Some(robot),
            Err(error) => return source.fail(written.span(), "fault.robot", error.to_string()),
        },
    };
    if sensor.get_ref().is_empty() {
        return source.fail(sensor.span(), "fault.sensor", "expected the name of a sensor");
    }
    let (largest, meaning) = match kind {
        FaultName::Dead => (0.0, ""),
        FaultName::Lost => (1.0, "a share up to 1"),
        FaultName::Late => (MAX_LATE, "up to 10 s"),
        FaultName::Noisy => (MAX_NOISE, "a standard deviation up to 1000"),
    };
    let amount = match (kind, amount) {
        (FaultName::Dead, None) => 0.0,
        (FaultName::Dead, Some(amount)) => {
            return source.fail(amount.span(), "fault.amount", "a dead sensor has none");
        }
        (_, None) => return source.fail(table.span(), "fault.amount", format!("missing: expected {meaning}")),
        (_, Some(amount)) => {
            let number = *amount.get_ref();
            if !(number > 0.0 && number <= largest) {
                let problem = format!("{}: expected more than 0, {meaning}", Number(number));
                return source.fail(amount.span(), "fault.amount", problem);
            }
            number
        }
    };
    let begin = *from.get_ref();
    if !(begin.is_finite() && begin >= 0.0) {
        let problem = format!("{}: expected seconds, not negative", Number(begin));
        return source.fail(from.span(), "fault.from", problem);
    }
    let end = until.as_ref().map_or(f64::INFINITY, |until| *until.get_ref());
    if let Some(until) = until.as_ref().filter(|_| !(end.is_finite() && end > begin)) {
        let problem = format!("{}: expected more than `from`, {}", Number(end), Number(begin));
        return source.fail(until.span(), "fault.until", problem);
    }
    Ok(FaultModel {
        at: format!("{}:{}", source.0.file, source.0.line(table.span().start)),
        robot,
        sensor: sensor.get_ref().clone(),
        kind: match kind {
            FaultName::Dead => FaultKind::Dead,
            FaultName::Lost => FaultKind::Lost(amount),
            FaultName::Late => FaultKind::Late(amount),
            FaultName::Noisy => FaultKind::Noisy(amount),
        },
        window: begin..end,
    })
}
