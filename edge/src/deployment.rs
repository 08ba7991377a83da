//! Robot section of a deployment file. What does `zenav-edge` read? The keys of the robot's side in `[robots.NAME]`, and `[security]`; the
//! rest of the file belongs to other components.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use zenav_edge::EdgeSettings;
use zenav_protocol::bus::SecuritySection;
use zenav_protocol::config_text::line_of;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::settings::Settings as _;

#[derive(Deserialize)]
struct Deployment {
    #[serde(default)]
    security: SecuritySection,
    #[serde(default)]
    robots: BTreeMap<String, RobotSection>,
}

/// `[robots.NAME]` and `[security]`; missing keys have the same effect as without a file.
#[derive(Debug, Default, PartialEq, Deserialize)]
pub(crate) struct RobotSection {
    pub(crate) model: Option<String>,
    pub(crate) listen: Option<String>,
    pub(crate) on_lost: Option<LostPolicy>,
    #[serde(default)]
    pub(crate) edge: EdgeSettings,
    /// The section beside it.
    #[serde(skip)]
    pub(crate) security: SecuritySection,
}

impl RobotSection {
    /// Reads the section of the robot `name` in the text of a file.
    ///
    /// # Errors
    /// With the file, the line, the key, and what was expected.
    pub(crate) fn of(path: &Path, text: &str, name: &str) -> Result<Self, String> {
        let path = path.display();
        let deployment: Deployment = toml::from_str(text).map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start));
            let line = before.map_or_else(String::new, |before| format!(":{}", 1 + before.matches('\n').count()));
            format!("{path}{line}: {}", error.message())
        })?;
        let names: Vec<_> = deployment.robots.keys().cloned().collect();
        let section = deployment.robots.into_iter().find(|(key, _)| key == name);
        let Some((_, mut section)) = section else {
            let robots = if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            };
            return Err(format!(
                "{path}: expected a section [robots.{name}]; its robots: {robots}"
            ));
        };
        section.edge.check().map_err(|error| {
            let error = error.within("edge").within(name).within("robots");
            let line = line_of(text, &error.key).map_or_else(String::new, |line| format!(":{line}"));
            format!("{path}{line}: {error}")
        })?;
        section.security = deployment.security;
        Ok(section)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use zenav_protocol::bus::Profile;

    use super::*;

    fn of(text: &str) -> Result<RobotSection, String> {
        RobotSection::of(Path::new("site.toml"), text, "neato7")
    }

    #[test]
    fn it_takes_what_concerns_the_robot_and_leaves_the_rest_to_others() {
        let section = of(
            "[planning]\nworkers = 2\n[security]\nprofile = \"mtls\"\nidentity = \"keys\"\n[robots.neato7]\nmodel = \"neato\"\ndriver = true\non_lost = \"stop\"\n\
             [robots.neato7.edge.collision_monitor]\nfeeling_speed = 0.0\n",
        )
        .unwrap();
        assert_eq!(section.model.as_deref(), Some("neato"));
        assert_eq!(section.on_lost, Some(LostPolicy::Stop));
        assert_eq!(section.listen, None);
        assert_eq!(section.security.profile, Some(Profile::Mtls));
        assert_eq!(section.security.identity.as_deref(), Some(Path::new("keys")));
        assert_eq!(section.edge.collision_monitor.feeling_speed, 0.0);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, parts) in [
            (
                "[robots.tiago]\n",
                ["site.toml: expected a section [robots.neato7]", "tiago"],
            ),
            ("", ["site.toml: expected a section [robots.neato7]", "none"]),
            ("[robots.neato7]\non_lost = \"run\"\n", ["site.toml:2:", "run"]),
            ("[security]\nprofile = \"tls\"\n", ["site.toml:2:", "tls"]),
            (
                "[robots.neato7]\n[robots.neato7.edge.collision_monitor]\nfeeling_sped = 0.0\n",
                ["site.toml:3:", "feeling_sped"],
            ),
            (
                "[robots.neato7]\n[robots.neato7.edge.collision_monitor]\nfeeling_speed = -1.0\n",
                ["site.toml:3:", "robots.neato7.edge.collision_monitor.feeling_speed"],
            ),
        ] {
            let error = of(text).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{text}: {error}");
        }
    }
}
