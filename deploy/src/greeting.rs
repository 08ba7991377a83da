//! Greeting of `zenav up`. What is running, and what to do with it, printed once when every part is ready.

use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use zenav_observability::logging::{self, Format};
use zenav_observability::readiness;
use zenav_protocol::bus::Bus;
use zenav_sim::World;

use crate::config::Deployment;
use crate::connect::DEFAULT_ENDPOINT;
use crate::{gateway, leadership};

/// Polling period for readiness.
const LOOK: Duration = Duration::from_millis(100);
/// After this time the greeting is printed even if parts are still waiting: each part logs what it waits for.
const PATIENCE: Duration = Duration::from_secs(15);

/// Contents of the greeting.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Greeting {
    robots: Vec<String>,
    world: String,
    /// Endpoint of the deployment for commands.
    endpoint: String,
    places: Vec<String>,
    /// Address of the mission-control page.
    page: Option<String>,
}

impl Greeting {
    pub(crate) fn new(deployment: &Deployment, world: &World, page: Option<String>) -> Self {
        Self {
            robots: deployment.robots.keys().cloned().collect(),
            world: deployment.simulation.world.clone(),
            endpoint: deployment.bus.connect.clone(),
            places: world.places().iter().map(|place| place.name.to_string()).collect(),
            page,
        }
    }

    /// Waits until every part is ready, then prints the greeting with the time since the start.
    pub(crate) async fn tell(self, began: Instant, bus: Option<&Bus>) {
        let (looks, mut is_ready) = (Instant::now(), false);
        while !is_ready && looks.elapsed() < PATIENCE {
            tokio::time::sleep(LOOK).await;
            is_ready = readiness::report().0;
        }
        let took = is_ready.then(|| began.elapsed());
        // Lets the parts' own log lines about readiness come first.
        tokio::time::sleep(2 * LOOK).await;
        let leaderless = match bus {
            Some(bus) => self.leaderless(bus).await,
            None => Vec::new(),
        };
        if logging::format() == Format::Text {
            for line in self.lines(took, &leaderless) {
                crate::output::note(line);
            }
        }
        if let Some(page) = &self.page {
            gateway::tell(page);
        }
    }

    /// Robots that none of the orchestrators that run may lead, each with the stores that may.
    async fn leaderless(&self, bus: &Bus) -> Vec<(String, Vec<String>)> {
        let mut looks = JoinSet::new();
        for robot in self.robots.iter().cloned() {
            let bus = bus.clone();
            looks.spawn(async move { Some((leadership::missing(&bus, &robot).await?, robot)) });
        }
        let found = looks.join_all().await.into_iter().flatten();
        let mut found: Vec<(String, Vec<String>)> = found.map(|(stores, robot)| (robot, stores)).collect();
        found.sort();
        found
    }

    /// The lines before the page's address; without a time, some part is not ready yet.
    fn lines(&self, took: Option<Duration>, leaderless: &[(String, Vec<String>)]) -> Vec<String> {
        let ready = match took {
            Some(took) => format!("ready in {:.1} s", took.as_secs_f64()),
            None => "not all parts are ready yet (`zenav doctor` says why)".to_owned(),
        };
        let robots = match self.robots.as_slice() {
            [] => "no robot".to_owned(),
            [robot] => format!("robot {robot}"),
            robots => format!("robots {}", robots.join(", ")),
        };
        let connect = if self.endpoint == DEFAULT_ENDPOINT {
            String::new()
        } else {
            format!(" --connect {}", self.endpoint)
        };
        let option = |robot: &str| match self.robots.as_slice() {
            [_, _, ..] => format!(" --robot {robot}"),
            _ => String::new(),
        };
        let robot = self.robots.first().map(|first| option(first)).unwrap_or_default();
        let goal = match self.places.first() {
            Some(place) => format!("--place {place}"),
            None => "X Y".to_owned(),
        };
        let mut lines = vec![format!("{ready}: {robots} in {}, router {}", self.world, self.endpoint)];
        if !self.places.is_empty() {
            lines.push(format!("places: {}", self.places.join(", ")));
        }
        for (robot, stores) in leaderless {
            lines.push(format!(
                "{robot} takes no goals: no orchestrator that runs may lead it, only {} may; start that one, or if it will not come back: \
                 zenav lease forget{}{connect}",
                stores.join(" or "),
                option(robot)
            ));
        }
        let is_led = |robot: &&String| !leaderless.iter().any(|(of, _)| of == *robot);
        let mut next = Vec::new();
        if let Some(led) = self.robots.iter().find(is_led) {
            next.push(format!("zenav goal submit {goal} --wait{}{connect}", option(led)));
        }
        next.push(format!("zenav map watch{robot}{connect}"));
        next.push(format!("zenav doctor{connect}"));
        lines.push(format!("next:   {}", next.join("\n        ")));
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn greeting(robots: &[&str], endpoint: &str, places: &[&str], leaderless: &[(String, Vec<String>)]) -> String {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let greeting = Greeting {
            robots: owned(robots),
            world: "kitchen".to_owned(),
            endpoint: endpoint.to_owned(),
            places: owned(places),
            page: None,
        };
        greeting.lines(Some(Duration::from_millis(640)), leaderless).join("\n")
    }

    #[test]
    fn the_commands_that_it_names_reach_this_deployment() {
        assert_eq!(
            greeting(&["tiago"], DEFAULT_ENDPOINT, &["corner", "sink"], &[]),
            "ready in 0.6 s: robot tiago in kitchen, router tcp/127.0.0.1:7447\n\
             places: corner, sink\n\
             next:   zenav goal submit --place corner --wait\n        zenav map watch\n        zenav doctor"
        );
        let other = greeting(&["anna", "bert"], "tcp/127.0.0.1:7000", &[], &[]);
        assert!(
            other.contains("zenav goal submit X Y --wait --robot anna --connect tcp/127.0.0.1:7000"),
            "{other}"
        );
    }

    #[test]
    fn a_robot_that_no_orchestrator_may_lead_is_told_with_the_cure() {
        let lost = [("anna".to_owned(), vec!["east".to_owned()])];
        let told = greeting(&["anna"], DEFAULT_ENDPOINT, &[], &lost);
        assert!(
            told.contains("anna takes no goals: no orchestrator that runs may lead it, only east may;"),
            "{told}"
        );
        assert!(
            told.contains(": zenav lease forget\n") && !told.contains("goal submit"),
            "{told}"
        );
        let other = greeting(&["anna", "bert"], DEFAULT_ENDPOINT, &[], &lost);
        assert!(other.contains(": zenav lease forget --robot anna\n"), "{other}");
        assert!(other.contains("goal submit X Y --wait --robot bert"), "{other}");
    }
}
