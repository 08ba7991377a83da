//! What would a tree do if its leaves answered in a given way? A recovery tree is simulated with a script, in simulated time.
//!
//! `cargo run -p zenav-behaviour-tree --example scripted`
#![allow(clippy::print_stdout, reason = "an example")]

use zenav_behaviour_tree::simulate::{Script, play, registry};
use zenav_behaviour_tree::{TreeErrors, build};

const TREE: &str = r#"<root BTCPP_format="4">
  <BehaviorTree ID="Deliver">
    <RetryUntilSuccessful num_attempts="3">
      <Sequence>
        <Timeout msec="5000"><DriveTo place="{shelf}"/></Timeout>
        <Fallback>
          <Grab item="cup"/>
          <Inverter><MakeRoom/></Inverter>
        </Fallback>
      </Sequence>
    </RetryUntilSuccessful>
  </BehaviorTree>
</root>"#;

/// The first grab fails; every drive takes two seconds.
const SCRIPT: &str = r#"{
  "leaves": { "DriveTo": { "run_ms": 2000 }, "Grab": { "fail": [[1, 1]] } },
  "blackboard": { "shelf": "north" }
}"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let script: Script = serde_json::from_str(SCRIPT)?;
    let mut no_includes = |_: &str, _: &str| Err("there are no other files".to_owned());
    let built: Result<_, TreeErrors> = build("deliver.xml", TREE.as_bytes(), &registry(), None, &mut no_includes);
    let mut tree = built?;
    let outcome = play(&mut tree, &script);
    println!("{}", tree.render());
    println!("{}", serde_json::to_string_pretty(&outcome)?);
    Ok(())
}
