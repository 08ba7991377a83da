//! Access control. Which messages may a link carry to and from a session that listens? Generates Zenoh's settings from the grants of the
//! key table.
//!
//! Zenoh denies everything that no rule allows. A rule must include the key of the message: an ask to all robots at once needs a rule for
//! all. `**` does not match chunks that begin with `@`, under which advanced publishers keep and number samples and announce themselves:
//! each of their keys needs a second rule key. A reply needs one rule on its way in and one on its way out.
//!
//! On the wire a namespace precedes every key. The members of a fleet have the same names in all its namespaces, so each rule holds in
//! every namespace, and without one; a key of the stack nested within another one is invalid.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::access::Grants;
use crate::member::{Member, Role};
use crate::topics::{TABLE, alive_key};

/// Allowance for attachments to a message beside its payload, bytes.
const ATTACHMENT: usize = 1024;
/// Every key of the stack, and every key of its advanced publishers.
const EVERYTHING: [&str; 2] = ["zenav/**", "zenav/**/@adv/**"];
/// A key of the stack nested within another: could pass for a robot's key in a namespace that is itself a key of the stack.
const NESTED: &str = "zenav/**/zenav/**";

/// `access_control` of a session with the identity `own`, for links from these members: the grants of each member, and nothing else.
pub(super) fn rules(fleet: &[Member], own: &Member) -> Value {
    let mut groups: BTreeMap<Grants, Vec<&Member>> = BTreeMap::new();
    for member in fleet {
        groups.entry(Grants::of(member)).or_default().push(member);
    }
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (grants, members)) in groups.into_iter().enumerate() {
        let is_router = members.iter().any(|member| member.role == Role::Router);
        let names: Vec<String> = members.iter().map(ToString::to_string).collect();
        let mut ids = Vec::new();
        let all = allowed(&grants).into_iter().map(|rule| ("allow", rule));
        // The robot's own side is written only by the robot itself, not even through a router.
        let guarded = is_router && own.role == Role::Robot;
        let own_side = guarded.then(|| format!("zenav/{}/edge/**", own.name.as_str()));
        let denied = Rule {
            flow: "ingress",
            messages: &["put"],
            keys: own_side.into_iter().chain([NESTED.to_owned()]).collect(),
        };
        for (permission, rule) in all.chain([("deny", denied)]) {
            if rule.keys.is_empty() {
                continue;
            }
            let id = format!("{number}-{}", ids.len());
            rules.push(json!({
                "id": id,
                "permission": permission,
                "flows": [rule.flow],
                "messages": rule.messages,
                "key_exprs": rule.keys.iter().map(|key| in_any_namespace(key)).collect::<Vec<_>>(),
            }));
            ids.push(id);
        }
        subjects.push(json!({ "id": number.to_string(), "cert_common_names": names }));
        policies.push(json!({ "rules": ids, "subjects": [number.to_string()] }));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

struct Rule {
    flow: &'static str,
    messages: &'static [&'static str],
    keys: Vec<String>,
}

/// What the far end of a link with these grants may send, and what may be sent to it.
fn allowed(grants: &Grants) -> Vec<Rule> {
    let rule = |flow, messages, keys| Rule { flow, messages, keys };
    let (kept, heard) = (advanced(&grants.keeps), advanced(&grants.hears));
    let everything: Vec<String> = EVERYTHING.map(str::to_owned).into();
    let seen = if grants.sees_alive {
        everything.clone()
    } else {
        Vec::new()
    };
    vec![
        // Publications, and samples kept for late joiners.
        rule("ingress", &["put"], [&grants.writes[..], &kept].concat()),
        rule("ingress", &["declare_queryable", "liveliness_token"], kept.clone()),
        rule("ingress", &["reply"], [&grants.keeps[..], &kept].concat()),
        // Asks that the far end serves.
        rule("ingress", &["declare_queryable", "reply"], grants.serves.clone()),
        rule("ingress", &["liveliness_token"], grants.alive.clone()),
        // Asks that the far end sends.
        rule("ingress", &["query"], grants.asks.clone()),
        rule("egress", &["reply"], grants.asks.clone()),
        // Topics that the far end subscribes to, including kept samples.
        rule("ingress", &["declare_subscriber"], [&grants.hears[..], &heard].concat()),
        rule(
            "ingress",
            &["query", "liveliness_query", "declare_liveliness_subscriber"],
            heard.clone(),
        ),
        rule("egress", &["put", "reply"], [&grants.hears[..], &heard].concat()),
        rule(
            "ingress",
            &["liveliness_query", "declare_liveliness_subscriber"],
            seen.clone(),
        ),
        // Servers and tokens of others, which a far end in mode `router` receives without asking: only those that it may ask or see.
        rule("egress", &["declare_queryable"], [&grants.asks[..], &heard].concat()),
        rule(
            "egress",
            &["liveliness_token"],
            [&grants.hears[..], &heard, &seen].concat(),
        ),
        // Requests and subscriptions of others for the far end: already checked on the link where they came in. They may have wildcards,
        // such as an ask to all robots, which no rule for one robot includes.
        rule(
            "egress",
            &[
                "query",
                "declare_subscriber",
                "liveliness_query",
                "declare_liveliness_subscriber",
            ],
            [&everything[..], &grants.serves].concat(),
        ),
    ]
}

/// A key in any namespace, or without one.
fn in_any_namespace(key: &str) -> String {
    format!("**/{key}")
}

/// Keys under which advanced publishers on these keys keep and number samples and announce themselves.
fn advanced(keys: &[String]) -> Vec<String> {
    keys.iter().map(|key| format!("{key}/@adv/**")).collect()
}

/// `low_pass_filter`: drops messages above the size limit of their key, which every reader would refuse anyway.
pub(super) fn size_limits() -> Value {
    let rows = TABLE.iter().map(|row| {
        json!({
            "flows": ["ingress"],
            "messages": [if row.qos.is_some() { "put" } else { "query" }],
            "key_exprs": [in_any_namespace(&alive_key(row.pattern, &[]))],
            "size_limit": row.max_bytes + ATTACHMENT,
        })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use zenoh::key_expr::KeyExpr;

    use super::*;

    fn fleet() -> Vec<Member> {
        let names = ["robot.a", "robot.b", "router.r", "service.s", "operator.o", "viewer.v"];
        names.iter().map(|name| name.parse().unwrap()).collect()
    }

    /// Whether the rules let a message pass, compared with Zenoh's own key matching.
    fn passes(rules: &Value, member: &str, flow: &str, message: &str, key: &str) -> bool {
        let has = |list: &Value, text: &str| list.as_array().unwrap().iter().any(|entry| entry == text);
        let key = KeyExpr::new(key).unwrap();
        let entries = |name: &str| rules[name].as_array().unwrap().clone();
        let subject = entries("subjects")
            .into_iter()
            .find(|subject| has(&subject["cert_common_names"], member));
        let Some(subject) = subject else { return false };
        let policy = entries("policies")
            .into_iter()
            .find(|policy| policy["subjects"][0] == subject["id"])
            .unwrap();
        let met: Vec<String> = entries("rules")
            .into_iter()
            .filter(|rule| has(&policy["rules"], rule["id"].as_str().unwrap()))
            .filter(|rule| has(&rule["flows"], flow) && has(&rule["messages"], message))
            .filter(|rule| {
                let keys = rule["key_exprs"].as_array().unwrap();
                keys.iter()
                    .any(|known| KeyExpr::new(known.as_str().unwrap()).unwrap().includes(&key))
            })
            .map(|rule| rule["permission"].as_str().unwrap().to_owned())
            .collect();
        met.iter().any(|permission| permission == "allow") && !met.iter().any(|permission| permission == "deny")
    }

    #[test]
    fn each_role_may_do_its_part_and_no_other() {
        let rules = rules(&fleet(), &"router.r".parse().unwrap());
        let may = |member: &str, flow: &str, message: &str, key: &str| passes(&rules, member, flow, message, key);
        for (member, message, key) in [
            ("robot.a", "put", "zenav/a/edge/state"),
            ("robot.a", "put", "zenav/a/edge/event/@adv/pub/1/2/_"),
            ("robot.a", "liveliness_token", "zenav/a/edge/event/@adv/pub/1/2/_"),
            ("robot.a", "declare_queryable", "zenav/a/edge/event/@adv/pub/1/2/_"),
            ("robot.a", "declare_queryable", "zenav/a/ask/edge/stop"),
            ("robot.a", "reply", "zenav/a/ask/edge/stop"),
            ("robot.a", "declare_subscriber", "zenav/*/edge/intent"),
            ("robot.a", "declare_subscriber", "zenav/a/cloud/plan"),
            ("robot.a", "query", "zenav/a/cloud/plan/@adv/**"),
            ("robot.a", "query", "zenav/sim/attach"),
            ("service.s", "put", "zenav/a/cloud/plan"),
            ("service.s", "query", "zenav/a/ask/edge/lease"),
            ("service.s", "query", "zenav/*/ask/cloud/goals"),
            ("service.s", "declare_queryable", "zenav/svc/motion/w-1"),
            ("service.s", "declare_queryable", "action/gripper"),
            ("operator.o", "put", "zenav/a/operator/teleop"),
            ("operator.o", "query", "zenav/a/ask/edge/stop"),
            ("operator.o", "query", "zenav/a/ask/cloud/goal"),
            ("viewer.v", "declare_subscriber", "zenav/**"),
            ("viewer.v", "query", "zenav/**/@adv/**"),
            ("viewer.v", "query", "zenav/*/ask/edge/info"),
            ("viewer.v", "liveliness_query", "zenav/*/alive/*"),
            ("router.r", "put", "zenav/b/cloud/plan"),
            ("robot.a", "put", "acme/site1/zenav/a/edge/state"),
            ("robot.a", "query", "site1/zenav/a/cloud/plan/@adv/**"),
            ("service.s", "declare_queryable", "site1/action/gripper"),
            ("viewer.v", "declare_subscriber", "site1/zenav/**"),
        ] {
            assert!(may(member, "ingress", message, key), "{member} {message} {key}");
        }
        for (member, message, key) in [
            ("robot.a", "put", "zenav/b/edge/state"),
            ("robot.a", "put", "zenav/*/edge/state"),
            ("robot.a", "put", "site1/zenav/b/edge/state"),
            ("robot.a", "put", "zenav/b/edge/zenav/a/edge/state"),
            ("robot.a", "put", "site1/zenav/a/cloud/plan"),
            ("robot.a", "put", "zenav/a/cloud/plan"),
            ("robot.a", "put", "zenav/a/operator/teleop"),
            ("robot.a", "put", "zenav/sim/clock"),
            ("robot.a", "query", "zenav/b/ask/edge/stop"),
            ("robot.a", "query", "zenav/a/ask/cloud/goal"),
            ("robot.a", "declare_queryable", "zenav/b/ask/edge/stop"),
            ("robot.a", "declare_subscriber", "zenav/**"),
            ("robot.a", "declare_subscriber", "zenav/b/edge/scan"),
            ("robot.a", "liveliness_token", "zenav/b/alive/edge"),
            ("service.s", "put", "zenav/a/edge/wheels"),
            ("service.s", "put", "zenav/a/body/readings"),
            ("service.s", "put", "zenav/a/operator/teleop"),
            ("service.s", "declare_queryable", "zenav/a/ask/edge/stop"),
            ("operator.o", "put", "zenav/a/cloud/plan"),
            ("operator.o", "put", "zenav/a/edge/wheels"),
            ("operator.o", "query", "zenav/a/ask/cloud/journal/x"),
            ("operator.o", "declare_queryable", "zenav/a/ask/cloud/goal"),
            ("operator.o", "query", "zenav/svc/motion/w-1"),
            ("viewer.v", "put", "zenav/a/operator/teleop"),
            ("viewer.v", "query", "zenav/a/ask/edge/stop"),
            ("viewer.v", "query", "zenav/a/ask/cloud/map"),
            ("viewer.v", "query", "zenav/**"),
            ("viewer.v", "declare_queryable", "zenav/a/ask/edge/info"),
            ("viewer.v", "liveliness_token", "zenav/a/alive/edge"),
            ("viewer.v", "query", "@/*/router"),
            ("viewer.stranger", "declare_subscriber", "zenav/a/edge/state"),
        ] {
            assert!(!may(member, "ingress", message, key), "{member} {message} {key}");
        }
        for (member, message, key) in [
            ("robot.a", "liveliness_token", "zenav/a/alive/mission"),
            ("robot.a", "liveliness_token", "zenav/a/cloud/plan/@adv/pub/1/2/_"),
            ("robot.a", "liveliness_token", "site1/zenav/a/alive/mapping"),
            ("robot.a", "declare_queryable", "zenav/sim/attach"),
            ("robot.a", "declare_queryable", "zenav/a/cloud/plan/@adv/pub/1/2/_"),
            ("robot.a", "declare_subscriber", "zenav/**"),
            ("robot.a", "declare_liveliness_subscriber", "zenav/*/alive/*"),
            ("viewer.v", "liveliness_token", "zenav/b/alive/edge"),
            ("viewer.v", "liveliness_token", "zenav/b/edge/event/@adv/pub/1/2/_"),
            ("operator.o", "liveliness_token", "zenav/svc/alive/motion/w-1"),
            ("operator.o", "declare_queryable", "zenav/b/ask/edge/stop"),
            ("service.s", "declare_queryable", "zenav/svc/motion/w-1"),
            ("service.s", "declare_queryable", "action/gripper"),
            ("router.r", "liveliness_token", "zenav/svc/alive/motion/w-1"),
            ("router.r", "declare_queryable", "zenav/a/ask/cloud/goal"),
        ] {
            assert!(may(member, "egress", message, key), "{member} {message} {key}");
        }
        for (member, message, key) in [
            ("robot.a", "liveliness_token", "zenav/b/alive/edge"),
            ("robot.a", "liveliness_token", "zenav/b/edge/event/@adv/pub/1/2/_"),
            ("robot.a", "liveliness_token", "zenav/svc/alive/motion/w-1"),
            ("robot.a", "liveliness_token", "site1/zenav/b/alive/edge"),
            ("robot.a", "declare_queryable", "zenav/b/ask/edge/stop"),
            ("robot.a", "declare_queryable", "zenav/a/ask/cloud/goal"),
            ("robot.a", "declare_queryable", "zenav/svc/motion/w-1"),
            ("viewer.v", "declare_queryable", "zenav/a/ask/edge/stop"),
        ] {
            assert!(!may(member, "egress", message, key), "{member} {message} {key}");
        }
        assert!(may("robot.a", "egress", "put", "zenav/a/cloud/plan"));
        assert!(may("robot.a", "egress", "query", "zenav/*/ask/edge/info"));
        assert!(!may("robot.a", "egress", "put", "zenav/b/edge/scan"));
        assert!(may("operator.o", "egress", "reply", "zenav/a/ask/edge/stop"));
    }

    #[test]
    fn on_a_robot_s_own_endpoint_not_even_a_router_writes_its_side() {
        let rules = rules(&fleet(), &"robot.a".parse().unwrap());
        let may = |key: &str| passes(&rules, "router.r", "ingress", "put", key);
        assert!(may("zenav/a/cloud/plan") && may("zenav/b/edge/intent") && may("zenav/a/body/readings"));
        assert!(!may("zenav/a/edge/wheels") && !may("site1/zenav/a/edge/wheels"));
        assert!(passes(
            &rules,
            "operator.o",
            "ingress",
            "query",
            "zenav/a/ask/edge/stop"
        ));
    }

    #[test]
    fn zenoh_takes_the_settings() {
        for members in [fleet(), Vec::new()] {
            let settings = json!({
                "access_control": rules(&members, &"router.r".parse().unwrap()),
                "low_pass_filter": size_limits(),
            });
            zenoh::Config::from_json5(&settings.to_string()).unwrap();
        }
    }
}
