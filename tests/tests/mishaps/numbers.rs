//! Extreme numbers in every field of every ask: does the robot still drive?

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::task::JoinSet;
use zenav_protocol::messages::{CancelRequest, EdgeState, GoalPhase, GoalsRequest, LeaseRole};
use zenav_protocol::topics::{self, Producer, TABLE};
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::observer::Observer;

use super::{LONG, ZENAV, drive, said};

/// One example of every message, one per line: its type, and its JSON.
const EXAMPLES: &str = include_str!("../../../protocol/tests/wire.golden");
/// Time for servers to answer, wall time; an answer is not required.
const SHORT: Duration = Duration::from_millis(500);

/// Extreme numbers as JSON texts; one of them is not JSON, one is not finite.
const LIMITS: [&str; 12] = [
    "0",
    "-1",
    "1e308",
    "-1e308",
    "5e-324",
    "1e999",
    "NaN",
    "0.5",
    "18446744073709551615",
    "18446744073709551616",
    "9223372036854775808",
    "4294967296",
];

/// Every example of a request, with each of its numbers, and with all of them, replaced by each extreme.
fn requests(name: &str) -> Vec<String> {
    let of = |line: &'static str| line.strip_prefix(name)?.strip_prefix(' ');
    let mut all = Vec::new();
    for example in EXAMPLES.lines().filter_map(of) {
        let value: Value = serde_json::from_str(example).unwrap();
        let numbers = count(&value);
        for limit in LIMITS {
            all.push(replaced(&value, None, limit));
            // Long examples, such as a robot's model, have many similar numbers.
            all.extend((0..numbers.min(12)).map(|nth| replaced(&value, Some(nth), limit)));
        }
    }
    all
}

fn count(value: &Value) -> usize {
    match value {
        Value::Number(_) => 1,
        Value::Array(values) => values.iter().map(count).sum(),
        Value::Object(fields) => fields.values().map(count).sum(),
        _ => 0,
    }
}

/// The text of a value with its nth number, or every number, replaced.
fn replaced(value: &Value, nth: Option<usize>, limit: &str) -> String {
    fn mark(value: &mut Value, nth: Option<usize>, at: &mut usize) {
        match value {
            Value::Number(_) => {
                if nth.is_none_or(|nth| nth == *at) {
                    *value = json!("@limit");
                }
                *at += 1;
            }
            Value::Array(values) => values.iter_mut().for_each(|value| mark(value, nth, at)),
            Value::Object(fields) => fields.values_mut().for_each(|value| mark(value, nth, at)),
            _ => {}
        }
    }
    let mut value = value.clone();
    mark(&mut value, nth, &mut 0);
    value.to_string().replace("\"@limit\"", limit)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn numbers_at_their_limits_in_every_field_of_every_ask_leave_the_robot_driving() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    drive(&deployment, "-0.9", "-0.2");
    let mut sent = 0;
    for row in TABLE
        .iter()
        .filter(|row| row.qos.is_none() && row.producer != Producer::Sim)
    {
        let key = row
            .pattern
            .replace("{robot}", ROBOT)
            .replace("{worker}", "*")
            .replace("{store}", "*");
        let begun = Instant::now();
        let mut waiting = JoinSet::new();
        for request in requests(row.message.split(" -> ").next().unwrap()) {
            sent += 1;
            let (bus, key) = (bus.clone(), key.clone());
            waiting.spawn(async move { bus.raw_query(&key, Some(request.into_bytes()), SHORT).await });
            if waiting.len() == 32 {
                waiting.join_next().await.unwrap().unwrap().unwrap();
            }
        }
        while let Some(answered) = waiting.join_next().await {
            answered.unwrap().unwrap();
        }
        eprintln!("{key}: {:?}", begun.elapsed());
    }
    assert!(sent > 1000, "{sent}");
    // The examples include a stop and an operator's lease, which the robot obeyed.
    let resumed = deployment.client(&["resume"]);
    assert_eq!(resumed.status.code(), Some(0), "{}", said(&resumed));
    let free = |state: &EdgeState| state.lease.live && state.lease.role == Some(LeaseRole::Mission);
    robot.until("the mission commands again", LONG, free).await;
    let open = GoalsRequest {
        states: vec![GoalPhase::Accepted, GoalPhase::Active, GoalPhase::Paused],
        ..GoalsRequest::default()
    };
    for goal in bus.ask(&topics::GOALS, &[ROBOT], &open, LONG).await.unwrap().goals {
        let cancel = CancelRequest {
            id: Some(goal.id),
            request_id: None,
        };
        bus.ask(&topics::CANCEL, &[ROBOT], &cancel, LONG).await.unwrap();
    }
    let begun = robot.next(LONG).await.stamp;
    drive(&deployment, "-0.9", "0.3");
    let took = robot.next(LONG).await.stamp.secs_since(begun);
    assert!(took < 60.0, "{took} s for half a metre");
    drive(&deployment, "-0.9", "-0.2");
    up.assert_running();
}
