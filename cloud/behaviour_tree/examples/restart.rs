//! How does a running tree survive the end of its process? It is stored between two ticks, and a fresh tree continues from there.
//!
//! `cargo run -p zenav-behaviour-tree --example restart`
#![allow(clippy::print_stdout, reason = "an example")]

use std::time::Duration;

use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Registry, Status, Tree, TreeErrors, TreeSnapshot, build};

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Brew">
    <Sequence><Pour cups="5"/><AlwaysSuccess name="serve"/></Sequence>
</BehaviorTree></root>"#;

/// Pours one cup per tick, and remembers how many it has poured. The context is the number of cups on the table.
struct Pour;

impl Leaf<u32> for Pour {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut u32) -> Status {
        match io.remember(&0_u32) {
            Ok(()) => Status::Running,
            Err(why) => io.fail(why.to_string()),
        }
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, table: &mut u32) -> Status {
        let poured = io.recall::<u32>().unwrap_or(0) + 1;
        *table += 1;
        let wanted = match io.get::<u64>("cups") {
            Ok(cups) => cups,
            Err(why) => return io.fail(why.to_string()),
        };
        if u64::from(poured) == wanted {
            return Status::Success;
        }
        io.say(format!("{poured} of {wanted} cups"));
        match io.remember(&poured) {
            Ok(()) => Status::Running,
            Err(why) => io.fail(why.to_string()),
        }
    }
}

fn brew() -> Result<Tree<u32>, TreeErrors> {
    let mut registry = Registry::new();
    let spec = NodeSpec::action("Pour", "Pours cups, one a tick.").input("cups", PortType::Unsigned, "how many");
    let added = registry.leaf(spec, |_| Box::new(Pour));
    assert!(added.is_ok(), "the only leaf of that name");
    build("brew.xml", TREE.as_bytes(), &registry, None, &mut |_, _| {
        Err("there are no other files".into())
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut table = 0;
    let mut tree = brew()?;
    for tick in 0..4 {
        tree.tick(Duration::from_millis(100 * tick), &mut table)?;
    }
    println!("before the restart, {table} cups on the table:\n{}", tree.render());
    let stored = serde_json::to_string(&tree.snapshot())?;
    drop(tree);

    let mut tree = brew()?;
    let snapshot: TreeSnapshot = serde_json::from_str(&stored)?;
    tree.restore(snapshot)?;
    let mut ticks = 4;
    while tree.tick(Duration::from_millis(100 * ticks), &mut table)? == Status::Running {
        ticks += 1;
    }
    println!("after it, {table} cups:\n{}", tree.render());
    assert_eq!(table, 5, "no cup is poured twice, none is forgotten");
    Ok(())
}
