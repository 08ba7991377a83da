//! Part. The processes that can run on a host.

use std::fmt;
use std::str::FromStr;

use zenav_protocol::id::Id;

/// A process of a deployment of many hosts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// A router, which the other parts connect to.
    Router,
    /// The simulated world of attached robots.
    World,
    /// The edge of a robot.
    Edge(Id),
    /// Mapping for all robots, or for one.
    Mapping(Option<Id>),
    /// Motion workers.
    Motion,
    /// Missions for all robots, or for one.
    Mission(Option<Id>),
    /// The mission-control page.
    Gateway,
}

impl FromStr for Part {
    type Err = String;

    /// Reads an entry of `runs`, such as `router` or `edge:tiago`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, robot) = match text.split_once(':') {
            Some((kind, robot)) => {
                let robot = Id::robot(robot).map_err(|error| format!("has `{text}`: {error}"))?;
                (kind, Some(robot))
            }
            None => (text, None),
        };
        match (kind, robot) {
            ("router", None) => Ok(Self::Router),
            ("world", None) => Ok(Self::World),
            ("motion", None) => Ok(Self::Motion),
            ("gateway", None) => Ok(Self::Gateway),
            ("edge", Some(robot)) => Ok(Self::Edge(robot)),
            ("mapping", robot) => Ok(Self::Mapping(robot)),
            ("mission", robot) => Ok(Self::Mission(robot)),
            _ => Err(format!(
                "has `{text}`: expected router, world, mapping, motion, mission, gateway or edge:ROBOT"
            )),
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.robot() {
            Some(robot) => write!(f, "{}:{robot}", self.kind()),
            None => f.write_str(self.kind()),
        }
    }
}

impl Part {
    /// Kind of the part, one word.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::World => "world",
            Self::Edge(_) => "edge",
            Self::Mapping(_) => "mapping",
            Self::Motion => "motion",
            Self::Mission(_) => "mission",
            Self::Gateway => "gateway",
        }
    }

    /// The one robot that the part serves; `None`: all.
    #[must_use]
    pub fn robot(&self) -> Option<&Id> {
        match self {
            Self::Edge(robot) => Some(robot),
            Self::Mapping(robot) | Self::Mission(robot) => robot.as_ref(),
            _ => None,
        }
    }

    /// Name on its host, as a DNS label: `_` in a robot's id becomes `-`.
    #[must_use]
    pub fn name(&self) -> String {
        match self.robot() {
            Some(robot) => format!("{}-{}", self.kind(), label(robot.as_str())),
            None => self.kind().to_owned(),
        }
    }

    /// Whether the part keeps data on disk.
    #[must_use]
    pub fn keeps_data(&self) -> bool {
        matches!(self, Self::Edge(_) | Self::Mapping(_) | Self::Mission(_))
    }

    /// Whether the part serves this robot.
    #[must_use]
    pub fn serves(&self, robot: &str) -> bool {
        self.robot().is_none_or(|one| one.as_str() == robot)
    }
}

/// A name as a DNS label (RFC 1123).
pub(super) fn label(name: &str) -> String {
    name.to_ascii_lowercase().replace('_', "-").trim_matches('-').to_owned()
}

/// Whether a name is a DNS label of at most 30 letters.
pub(super) fn is_label(name: &str) -> bool {
    (1..=30).contains(&name.len())
        && label(name) == name
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_reads_as_it_is_written() {
        for text in [
            "router",
            "world",
            "edge:tiago_1",
            "mapping",
            "mapping:tiago_1",
            "motion",
            "mission:a",
            "gateway",
        ] {
            assert_eq!(text.parse::<Part>().unwrap().to_string(), text);
        }
        for (text, why) in [
            ("edge", "edge:ROBOT"),
            ("routers", "expected router"),
            ("motion:a", "expected router"),
            ("edge:svc", "not svc"),
        ] {
            assert!(text.parse::<Part>().unwrap_err().contains(why), "{text}");
        }
        assert_eq!("edge:Tiago_1".parse::<Part>().unwrap().name(), "edge-tiago-1");
        assert!(is_label("fleet-a") && !is_label("fleet_a") && !is_label("-a") && !is_label("") && !is_label("Ab"));
    }
}
