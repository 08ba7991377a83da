//! Can a program in any language carry out an action of a tree? With real processes: a deployment, and a separate server.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, Output};

use zenav_protocol::messages::{RemoteReply, RemoteRequest, RemoteStatus};
use zenav_protocol::topics;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::process::Process;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
const KEY: &str = "kitchen/gripper";
const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
    <RemoteAction name="Grab" server="kitchen/gripper" item="{item}" weight="{weight}"/>
    <ScriptCondition code="weight == 3"/>
</Sequence></BehaviorTree></root>"#;

/// Submits the tree and waits for its end.
fn grab(deployment: &Deployment, item: &str) -> Output {
    let tree = deployment.folder().join("grab.xml");
    std::fs::write(&tree, TREE).unwrap();
    let (tree, item) = (tree.to_string_lossy().into_owned(), format!("item={item}"));
    deployment.client(&[
        "goal",
        "submit",
        "--robot",
        ROBOT,
        "--tree",
        &tree,
        "--blackboard",
        &item,
        "--wait",
        "-o",
        "json",
        "--timeout",
        "30",
    ])
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_program_beside_the_stack_does_an_action_of_a_tree_once() {
    let deployment = Deployment::new(ZENAV, "kitchen", 2.0);
    let _up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut server = bus.serve(&topics::REMOTE_ACTION, &[KEY]).unwrap();
    let serving = tokio::spawn(async move {
        let mut asked: BTreeMap<String, u32> = BTreeMap::new();
        while let Some(request) = server.next().await {
            let body: RemoteRequest = request.body.clone();
            let times = asked.entry(body.execution.clone()).or_default();
            *times += 1;
            let ends = *times > 5;
            request.reply(&RemoteReply {
                execution: body.execution,
                status: if ends {
                    RemoteStatus::Success
                } else {
                    RemoteStatus::Running
                },
                feedback: "closes".into(),
                outputs: [("weight".to_owned(), 3.into())].into(),
            });
            if ends {
                break;
            }
        }
        (asked, server)
    });
    let ended = tokio::task::block_in_place(|| grab(&deployment, "cup"));
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    let (asked, _server) = serving.await.unwrap();
    assert_eq!(asked.len(), 1, "one execution: {asked:?}");
}

/// A Python with the package `zenoh`: `PYTHON`, otherwise `python3`.
fn python() -> PathBuf {
    let python = PathBuf::from(std::env::var_os("PYTHON").unwrap_or_else(|| "python3".into()));
    let check = Command::new(&python).args(["-c", "import zenoh"]).output();
    let name = python.display();
    let check = check.unwrap_or_else(|error| panic!("`{name}` does not run: {error}; set PYTHON"));
    assert!(
        check.status.success(),
        "`{name}` has no module zenoh: {name} -m pip install eclipse-zenoh"
    );
    python
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs a Python with eclipse-zenoh, which .ci/run installs: PYTHON=… cargo test -p zenav-tests --test remote_action -- --ignored"]
async fn the_python_example_does_an_action_of_a_tree_and_its_failure_has_its_reason() {
    let python = python();
    let deployment = Deployment::new(ZENAV, "kitchen", 2.0);
    let _up = deployment.start_up();
    let bus = deployment.bus().await;
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../cloud/mission/examples/remote_action.py"
    );
    let mut server = Process::start(&python, &[script, KEY, &deployment.router], deployment.folder());
    let grabbed = tokio::task::block_in_place(|| grab(&deployment, "cup"));
    assert_eq!(grabbed.status.code(), Some(0), "{grabbed:?}\n{}", server.log());
    let wrong = tokio::task::block_in_place(|| grab(&deployment, "7"));
    assert_eq!(wrong.status.code(), Some(1), "{wrong:?}");
    let told = String::from_utf8_lossy(&wrong.stdout).into_owned();
    assert!(told.contains("`item`: expected text"), "{told}");
    server.assert_running();
    assert_eq!(server.log().matches("begins").count(), 2);
    bus.close().await;
}
