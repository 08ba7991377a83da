//! Tests of SubTrees and their view of the blackboard.

use super::rig::Rig;
use crate::Value;

/// `main` in the main tree, `sub` in the tree Sub.
fn rig(main: &str, sub: &str) -> Rig {
    Rig::new(&format!("{main}</BehaviorTree><BehaviorTree ID=\"Sub\">{sub}"))
}

#[test]
fn a_subtree_has_its_own_blackboard() {
    let mut rig = rig(
        r#"<Sequence><Script code="x := 1"/><SubTree ID="Sub"/></Sequence>"#,
        r#"<Peek value="{x}"/>"#,
    );
    rig.ticks(1);
    assert!(rig.log().contains("no value yet"));
}

#[test]
fn names_are_remapped_both_ways_and_literals_are_entries() {
    let mut rig = rig(
        r#"<Sequence><Script code="x := 1"/><SubTree ID="Sub" in="{x}" same="{=}" out="{y}" word="hello 3"/></Sequence>"#,
        r#"<Sequence><Peek value="{in}"/><Peek value="{word}"/><Script code="out := in + 1; same := 7"/></Sequence>"#,
    );
    assert_eq!(rig.ticks(1), "S");
    assert_eq!(rig.log(), "1 hello 3");
    assert_eq!(rig.tree.blackboard().get("y"), Some(&Value::Double(2.0)));
    assert_eq!(rig.tree.blackboard().get("same"), Some(&Value::Int(7)));
}

#[test]
fn a_literal_true_is_true_in_scripts_and_false_skips() {
    let mut literal = rig(
        r#"<SubTree ID="Sub" f="true" g="false"/>"#,
        r#"<ScriptCondition code="f == true &amp;&amp; g == false"/>"#,
    );
    assert_eq!(literal.ticks(1), "S");
    let mut written = Rig::new(
        r#"<Sequence><SetBlackboard value="false" output_key="f"/><T name="a" _skipIf="f == false"/>
        <Script code="f := true"/><SetBlackboard value="false" output_key="f"/><T name="b" _skipIf="f == false"/></Sequence>"#,
    );
    assert_eq!(written.ticks(1), "S");
    assert_eq!(written.log(), "");
}

#[test]
fn numbers_in_a_remapping_are_numbers_and_an_entry_that_a_port_names_may_be_assigned_to() {
    let mut numbers = rig(
        r#"<SubTree ID="Sub" low="9" high="10" half="0.5" code="1;2"/>"#,
        r#"<ScriptCondition code="low &lt; high &amp;&amp; low + high == 19 &amp;&amp; half * 2 == 1 &amp;&amp; code == '1;2'"/>"#,
    );
    assert_eq!(numbers.ticks(1), "S");
    let mut named = Rig::new(r#"<Sequence><Script code="n = 3"/><Peek value="{n}"/></Sequence>"#);
    assert_eq!(named.ticks(1), "S");
    assert_eq!(named.log(), "3");
}

#[test]
fn autoremap_shares_all_but_private_names() {
    let mut rig = rig(
        r#"<Sequence><Script code="x := 1; _p := 2"/><SubTree ID="Sub" _autoremap="true"/></Sequence>"#,
        r#"<Sequence><Peek value="{x}"/><Script code="made := 5; _p := 9"/></Sequence>"#,
    );
    assert_eq!(rig.ticks(1), "S");
    assert_eq!(rig.log(), "1");
    assert_eq!(rig.tree.blackboard().get("made"), Some(&Value::Int(5)));
    assert_eq!(rig.tree.blackboard().get("_p"), Some(&Value::Int(2)));
}

#[test]
fn an_at_sign_reaches_the_root_from_any_depth() {
    let mut rig = rig(
        r#"<Sequence><Script code="x := 1"/><SubTree ID="Sub"/></Sequence>"#,
        r#"<Sequence><Peek value="{@x}"/><Script code="@x = @x + 1"/></Sequence>"#,
    );
    assert_eq!(rig.ticks(1), "S");
    assert_eq!(rig.tree.blackboard().get("x"), Some(&Value::Int(2)));
}

#[test]
fn two_uses_of_a_tree_share_nothing() {
    let mut rig = rig(
        r#"<Sequence><SubTree ID="Sub" n="1" name="one"/><SubTree ID="Sub" n="2" name="two"/></Sequence>"#,
        r#"<Sequence><Peek value="{n}"/><ScriptCondition code="n &lt; 3" _onSuccess="seen := n"/></Sequence>"#,
    );
    assert_eq!(rig.ticks(1), "S");
    assert_eq!(rig.log(), "1 2");
    let names: Vec<String> = rig
        .tree
        .iter()
        .map(|node| format!("{}:{}", node.uid, node.name))
        .collect();
    assert_eq!(names[..3], ["1:Sequence", "2:one", "3:Sequence"]);
    assert_eq!(names[5], "6:two");
}

#[test]
fn a_subtree_reports_the_id_of_its_tree_and_is_drawn_with_its_nodes() {
    let mut rig = rig(
        r#"<Sequence name="go"><SubTree ID="Sub"/><T name="b"/></Sequence>"#,
        r#"<T name="a" plan="R"/>"#,
    );
    rig.ticks(1);
    assert_eq!(
        rig.tree.render(),
        "go [Sequence]  RUNNING\n├─ Sub  RUNNING\n│  └─ a [T]  RUNNING\n└─ b [T]\n"
    );
    rig.halt();
    assert!(rig.tree.render().starts_with("go [Sequence]  (RUNNING)\n"));
}

#[test]
fn a_tree_is_drawn_as_it_is_written_with_ports_and_scripts() {
    let rig = rig(
        r#"<Sequence name="go"><SubTree ID="Sub" n="{m}" _autoremap="true"/><T name="b" plan="R" _skipIf="m > 1 &amp;&amp;
            m != 3" _uid="7"/></Sequence>"#,
        r#"<Peek value="{n}"/>"#,
    );
    assert_eq!(
        rig.tree.render_written(),
        "go [Sequence]\n├─ Sub n=\"{m}\" _autoremap=\"true\"\n│  └─ Peek value=\"{n}\"\n└─ b [T] plan=\"R\" _skipIf=\"m > 1 && m != 3\"\n"
    );
    assert_eq!(rig.tree.written(3).collect::<Vec<_>>(), [("value", "{n}")]);
    assert_eq!(rig.tree.written(0).count() + rig.tree.written(99).count(), 0);
}

#[test]
fn the_model_of_a_subtree_gives_defaults_to_what_is_not_remapped() {
    let mut rig = Rig::new(
        r#"<SubTree ID="Sub"/></BehaviorTree><TreeNodesModel><SubTree ID="Sub"><input_port name="n" default="4"/></SubTree></TreeNodesModel><BehaviorTree ID="Sub"><Peek value="{n}"/>"#,
    );
    rig.ticks(1);
    assert_eq!(rig.log(), "4");
}

/// Groot2's own annotations, both forms of a node, and models of nodes that are already known.
#[cfg(feature = "nav2")]
#[test]
fn a_file_as_groot2_writes_it_is_read() {
    let text = r#"<?xml version="1.0" encoding="UTF-8"?>
<root BTCPP_format="4" project_name="Project" main_tree_to_execute="Main">
  <!-- ////////// -->
  <BehaviorTree ID="Main" editable="true" _fullpath="a/b" _description="main">
    <Sequence name="root_seq" _uid="1" _description="x">
      <Script code=" msg:='hello' " _onSuccess="done:=true"/>
      <SubTree ID="Sub" _autoremap="true" name="s" _fullpath="s::4"/>
      <Action ID="Sleep" msec="10" _skipIf="false"/>
      <AlwaysSuccess _failureIf="" _while=" "/>
      <Decorator ID="RateController" hz="5"><Condition ID="ScriptCondition" code="1 == 1"/></Decorator>
    </Sequence>
  </BehaviorTree>
  <BehaviorTree ID="Sub"><AlwaysSuccess/></BehaviorTree>
  <!-- Description of Node Models (used by Groot) -->
  <TreeNodesModel>
    <Action ID="Grab" editable="true">
      <input_port name="where" type="std::string" default="here">place</input_port>
      <MetadataFields><Metadata k="v"/></MetadataFields>
    </Action>
    <SubTree ID="Sub" editable="true"><MetadataFields><Metadata k="v"/></MetadataFields></SubTree>
    <Decorator ID="RateController"><input_port name="hz" default="10.0" type="double"/></Decorator>
  </TreeNodesModel>
</root>"#;
    let none = &mut |_: &str, _: &str| Err("none".to_owned());
    let mut tree = crate::build("groot.xml", text.as_bytes(), &super::rig::registry(), None, none)
        .unwrap_or_else(|errors| panic!("{errors}"));
    let mut world = super::rig::World::default();
    let mut answers = Vec::new();
    for ms in [0, 20] {
        answers.push(tree.tick(std::time::Duration::from_millis(ms), &mut world).unwrap());
    }
    assert_eq!(answers, [crate::Status::Running, crate::Status::Success]);
    assert_eq!(tree.blackboard().get("done").and_then(Value::as_bool), Some(true));
}
