//! Access. Which keys may a member of a fleet write, serve, ask and subscribe to? The key table decides; everything else is denied.
//!
//! | role | writes and serves | asks | hears |
//! |---|---|---|---|
//! | robot | what edge and body write and serve, under its own name | asks for robots | its own keys, others' intents, simulated time |
//! | service | what mapping, motion and mission write and serve, for all robots; actions of trees | all but asks for robots | everything |
//! | operator | teleoperation and heartbeats | asks for operators and viewers | everything |
//! | viewer | nothing | asks for viewers | everything |
//! | router | everything | everything | everything |

use crate::member::{Member, Role};
use crate::topics::{ALIVE_COMPONENT, ALIVE_WORKER, Asker, INTENT, Producer, Qos, Row, TABLE, alive_key};

/// Every key of the stack.
const EVERYTHING: &str = "zenav/**";
/// Keys on which external programs serve the actions of behaviour trees, where access is controlled.
const ACTIONS: &str = "action/**";

/// Keys that a member may use; `*` matches any chunk, `**` any number of chunks.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Grants {
    /// Topics that the member writes.
    pub writes: Vec<String>,
    /// Written topics whose samples the writer keeps for late joiners.
    pub keeps: Vec<String>,
    /// Asks that the member serves.
    pub serves: Vec<String>,
    /// Asks that the member sends.
    pub asks: Vec<String>,
    /// Topics that the member subscribes to.
    pub hears: Vec<String>,
    /// Liveliness tokens that the member declares.
    pub alive: Vec<String>,
    /// Whether the member sees all liveliness tokens.
    pub sees_alive: bool,
}

impl Grants {
    /// The keys that the key table grants a member.
    ///
    /// ```
    /// use zenav_protocol::access::Grants;
    ///
    /// let robot = Grants::of(&"robot.tiago".parse()?);
    /// assert!(robot.writes.contains(&"zenav/tiago/edge/state".to_owned()));
    /// assert!(!robot.writes.iter().any(|key| key.ends_with("/cloud/plan")));
    /// let viewer = Grants::of(&"viewer.wall".parse()?);
    /// assert!(viewer.writes.is_empty() && viewer.hears == ["zenav/**"]);
    /// # Ok::<(), zenav_protocol::member::NoMember>(())
    /// ```
    #[must_use]
    pub fn of(member: &Member) -> Self {
        let role = member.role;
        if role == Role::Router {
            let all = || vec![EVERYTHING.to_owned(), ACTIONS.to_owned()];
            return Self {
                writes: all(),
                keeps: all(),
                serves: all(),
                asks: all(),
                hears: all(),
                alive: all(),
                sees_alive: true,
            };
        }
        let robot = match role {
            Role::Robot => member.name.as_str(),
            _ => "*",
        };
        let key = |row: &Row| alive_key(row.pattern, &[robot]);
        let mut grants = Self::default();
        for row in TABLE {
            match (row.qos, row.asked_by) {
                (Some(qos), _) if is_written(row.producer, role) => {
                    grants.writes.push(key(row));
                    if matches!(qos, Qos::Events { .. } | Qos::State) {
                        grants.keeps.push(key(row));
                    }
                }
                (None, Some(asker)) => {
                    if is_written(row.producer, role) {
                        grants.serves.push(key(row));
                    }
                    if is_asked(asker, role) {
                        grants.asks.push(key(row));
                    }
                }
                _ => {}
            }
        }
        match role {
            Role::Robot => {
                grants.hears.push(format!("zenav/{robot}/**"));
                grants.hears.push(alive_key(INTENT.pattern, &[]));
                grants.hears.push("zenav/sim/**".to_owned());
                grants.alive.push(alive_key(ALIVE_COMPONENT, &[robot]));
            }
            _ => {
                grants.hears.push(EVERYTHING.to_owned());
                grants.sees_alive = true;
            }
        }
        if role == Role::Service {
            grants.serves.push(ACTIONS.to_owned());
            grants.asks.push(ACTIONS.to_owned());
            grants.alive.push(alive_key(ALIVE_COMPONENT, &[]));
            grants.alive.push(alive_key(ALIVE_WORKER, &[]));
        }
        grants
    }
}

/// Whether a role may write or serve as this producer.
fn is_written(producer: Producer, role: Role) -> bool {
    match producer {
        Producer::Edge | Producer::Body => role == Role::Robot,
        Producer::Mapping | Producer::Motion | Producer::Mission => role == Role::Service,
        // The mission-control page runs under an operator's certificate.
        Producer::Holder | Producer::Part => matches!(role, Role::Service | Role::Operator),
        Producer::Operator => role == Role::Operator,
        // A world server is a router.
        Producer::Sim => false,
    }
}

fn is_asked(asker: Asker, role: Role) -> bool {
    match asker {
        Asker::Viewer => matches!(role, Role::Viewer | Role::Operator | Role::Service),
        Asker::Operator => matches!(role, Role::Operator | Role::Service),
        Asker::Service => role == Role::Service,
        Asker::Robot => role == Role::Robot,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(member: &str) -> Grants {
        Grants::of(&member.parse().unwrap())
    }

    #[test]
    fn a_robot_writes_and_serves_under_its_own_name_alone() {
        let robot = of("robot.tiago");
        assert!(robot.writes.contains(&"zenav/tiago/edge/state".to_owned()));
        assert!(robot.writes.contains(&"zenav/tiago/edge/scan/*".to_owned()));
        assert!(robot.writes.contains(&"zenav/tiago/body/readings".to_owned()));
        assert!(robot.serves.contains(&"zenav/tiago/ask/edge/stop".to_owned()));
        assert_eq!(robot.keeps, ["zenav/tiago/edge/event"]);
        assert_eq!(robot.asks, ["zenav/sim/attach"]);
        for key in [&robot.writes, &robot.keeps, &robot.serves, &robot.alive]
            .into_iter()
            .flatten()
        {
            assert!(key.starts_with("zenav/tiago/"), "{key}");
        }
    }

    #[test]
    fn a_viewer_writes_and_serves_nothing_and_asks_nothing_that_changes() {
        let viewer = of("viewer.wall");
        assert!(viewer.writes.is_empty() && viewer.serves.is_empty() && viewer.alive.is_empty());
        let asks = [
            "zenav/*/ask/edge/info",
            "zenav/*/ask/cloud/goals",
            "zenav/*/ask/cloud/info",
            "zenav/svc/info/*",
            "zenav/svc/schema/*",
        ];
        assert_eq!(viewer.asks, asks);
    }

    #[test]
    fn an_operator_drives_and_asks_and_writes_no_plan() {
        let operator = of("operator.anna");
        assert_eq!(operator.writes, ["zenav/*/cloud/heartbeat", "zenav/*/operator/teleop"]);
        assert!(operator.asks.contains(&"zenav/*/ask/edge/stop".to_owned()));
        assert!(!operator.asks.contains(&"zenav/*/ask/cloud/join".to_owned()));
        assert_eq!(
            operator.serves,
            ["zenav/svc/log/*", "zenav/svc/info/*", "zenav/svc/schema/*"]
        );
    }

    #[test]
    fn a_service_writes_plans_and_nothing_of_a_robot_s_side() {
        let service = of("service.site1");
        assert!(service.writes.contains(&"zenav/*/cloud/plan".to_owned()));
        assert!(service.serves.contains(&"zenav/svc/motion/*".to_owned()));
        let sides = ["/edge/", "/body/", "/operator/", "zenav/sim"];
        for key in service.writes.iter().chain(&service.serves) {
            assert!(!sides.iter().any(|side| key.contains(side)), "{key}");
        }
    }

    #[test]
    fn somebody_writes_or_serves_every_row_and_nobody_what_another_role_does() {
        let roles = [Role::Robot, Role::Service, Role::Operator];
        for row in TABLE {
            let writers = roles.into_iter().filter(|role| is_written(row.producer, *role)).count();
            let expected = match row.producer {
                Producer::Sim => 0,
                Producer::Holder | Producer::Part => 2,
                _ => 1,
            };
            assert_eq!(writers, expected, "{}", row.pattern);
        }
    }
}
