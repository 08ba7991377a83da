//! Tests of invalid files: a tree is data, so invalid trees are input.

use super::rig::{World, registry};
use crate::{Limits, TreeErrors, build, build_within, check};

fn errors_of(text: &str) -> Vec<String> {
    let result = build("bad.xml", text.as_bytes(), &registry(), None, &mut |_, _| {
        Err("not found".into())
    });
    match result {
        Ok(_) => Vec::new(),
        Err(TreeErrors { errors, .. }) => errors.iter().map(ToString::to_string).collect(),
    }
}

/// The errors of one tree named Main.
fn in_tree(body: &str) -> Vec<String> {
    errors_of(&format!(
        "<root BTCPP_format=\"4\">\n<BehaviorTree ID=\"Main\">\n{body}\n</BehaviorTree>\n</root>"
    ))
}

#[test]
fn every_mistake_of_a_node_is_told_with_its_place_and_what_was_expected() {
    for (body, expected) in [
        (
            "<Sequense><T/></Sequense>",
            "bad.xml:3:1: unknown node `Sequense`: expected a registered node, perhaps `Sequence`",
        ),
        (
            "<T plam=\"S\"/>",
            "bad.xml:3:4: `T` has no port `plam`: expected one of plan, perhaps `plan`",
        ),
        (
            "<AlwaysSuccess x=\"1\"/>",
            "bad.xml:3:16: `AlwaysSuccess` has no port `x`: expected no port",
        ),
        (
            "<Sleep/>",
            "bad.xml:3:1: `Sleep` without port `msec`: expected an integer of at least 0 (wait, ms)",
        ),
        (
            "<Sleep msec=\"-5\"/>",
            "bad.xml:3:8: port `msec` is `-5`: expected an integer of at least 0",
        ),
        (
            "<Sleep msec=\"{}\"/>",
            "bad.xml:3:8: `{}` names no blackboard entry: expected {name}, of letters, digits and _",
        ),
        #[cfg(feature = "nav2")]
        (
            "<RoundRobin wrap_around=\"maybe\"><T/></RoundRobin>",
            "bad.xml:3:13: port `wrap_around` is `maybe`: expected true or false",
        ),
        (
            "<Inverter/>",
            "bad.xml:3:1: `Inverter` has 0 children: expected exactly 1",
        ),
        (
            "<Sequence/>",
            "bad.xml:3:1: `Sequence` has 0 children: expected at least 1",
        ),
        #[cfg(feature = "nav2")]
        (
            "<RecoveryNode><T/></RecoveryNode>",
            "bad.xml:3:1: `RecoveryNode` has 1 children: expected exactly 2",
        ),
        ("<T><T/></T>", "bad.xml:3:1: `T` has 1 children: expected none"),
        (
            "<IfThenElse><T/><T/><T/><T/></IfThenElse>",
            "bad.xml:3:1: `IfThenElse` has 4 children: expected 2 to 3",
        ),
        (
            "<Condition ID=\"T\"/>",
            "bad.xml:3:1: `T` as <Condition>: expected <Action ID=\"T\">",
        ),
        (
            "<Action/>",
            "bad.xml:3:1: <Action> without ID: expected the registration id",
        ),
        (
            "<SubTree ID=\"Maim\"/>",
            "bad.xml:3:1: unknown tree `Maim`: expected the ID of a <BehaviorTree>, perhaps `Main`",
        ),
        (
            "<Script code=\"x :=\"/>",
            "bad.xml:3:9: port `code`: script ends too early at character 5: expected a name, a number, 'text' or (",
        ),
        (
            "<T _skipIf=\"1 +\"/>",
            "bad.xml:3:4: _skipIf: script ends too early at character 4: expected a name, a number, 'text' or (",
        ),
        (
            "<T _skipif=\"1\"/>",
            "bad.xml:3:4: unknown attribute `_skipif`: expected `_skipIf`",
        ),
        (
            "<LoopInt queue=\"1\" value=\"x\"><T/></LoopInt>",
            "bad.xml:3:20: output port `value` is the literal `x`: expected a blackboard entry, as in {key}",
        ),
        (
            "<Precondition if=\"1\" else=\"maybe\"><T/></Precondition>",
            "bad.xml:3:22: port `else` is `maybe`: expected SUCCESS, FAILURE, SKIPPED or RUNNING",
        ),
        (
            "<LoopInt queue=\"1;x;3\"><T/></LoopInt>",
            "bad.xml:3:10: port `queue` is `1;x;3`: expected integers separated by ;",
        ),
        #[cfg(feature = "nav2")]
        (
            "<RateController hz=\"-3\"><T/></RateController>",
            "bad.xml:3:17: port `hz` is `-3`: expected a number above 0",
        ),
        (
            "<UnsetBlackboard key=\"\"/>",
            "bad.xml:3:18: port `key` is ``: expected the name of a blackboard entry",
        ),
        (
            "<Main/>",
            "bad.xml:3:1: <Main> is a tree: expected <SubTree ID=\"Main\"/>",
        ),
    ] {
        assert_eq!(in_tree(body), [expected], "{body}");
    }
}

#[test]
fn all_errors_are_told_at_once_also_of_trees_that_are_not_used() {
    let errors = errors_of(
        "<root BTCPP_format=\"4\" main_tree_to_execute=\"A\">
<BehaviorTree ID=\"A\"><Sequence><Foo/><Sleep msec=\"x\"/><Inverter/></Sequence></BehaviorTree>
<BehaviorTree ID=\"B\"><Bar/></BehaviorTree>
<Nonsense/>
</root>",
    );
    assert_eq!(errors.len(), 5, "{errors:#?}");
    // Errors for a tree with too many children, a duplicate id, and a missing id.
    let errors = errors_of(
        "<root BTCPP_format=\"4\" main_tree_to_execute=\"A\">
<BehaviorTree ID=\"A\"><Foo/><Sleep msec=\"x\"/></BehaviorTree>
<BehaviorTree ID=\"A\"><Bar/></BehaviorTree>
<BehaviorTree><Baz/></BehaviorTree>
</root>",
    );
    for part in [
        "2:1: tree `A` has 2 children",
        "2:22: unknown node `Foo`",
        "2:35: port `msec` is `x`",
        "3:1: tree `A` is defined twice",
        "3:22: unknown node `Bar`",
        "4:1: <BehaviorTree> without ID",
        "4:15: unknown node `Baz`",
    ] {
        let told = errors.iter().filter(|error| error.contains(part)).count();
        assert_eq!(told, 1, "{part}: {errors:#?}");
    }
    assert_eq!(errors.len(), 7, "{errors:#?}");
    let nameless = "<root main_tree_to_execute=\"B\"><BehaviorTree><T/></BehaviorTree><BehaviorTree ID=\"B\"><T/></BehaviorTree></root>";
    assert!(errors_of(nameless)[0].contains("without ID"));
}

#[test]
fn the_frame_of_a_file_is_checked() {
    for (text, part) in [
        ("", "not XML"),
        ("<root", "not XML"),
        ("<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"></root>", "not XML"),
        ("<tree/>", "expected <root BTCPP_format"),
        ("<root BTCPP_format=\"3\"/>", "BTCPP_format `3`: expected 4"),
        ("<root BTCPP_format=\"4\"/>", "no tree"),
        (
            "<root BTCPP_format=\"4\" main_tree=\"A\"/>",
            "unknown attribute `main_tree`",
        ),
        (
            "<root BTCPP_format=\"4\" main_tree_to_execute=\"B\"><BehaviorTree ID=\"A\"><T/></BehaviorTree></root>",
            "unknown tree `B`",
        ),
        (
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"><T/><T/></BehaviorTree></root>",
            "tree `A` has 2 children: expected exactly 1",
        ),
        (
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"><T/></BehaviorTree><BehaviorTree ID=\"B\"><T/></BehaviorTree></root>",
            "several trees",
        ),
        (
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"><T/></BehaviorTree><BehaviorTree ID=\"A\"><T/></BehaviorTree></root>",
            "defined twice, first at bad.xml:1:24",
        ),
        (
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Sequence\"><T/></BehaviorTree></root>",
            "tree `Sequence` has the name of a node",
        ),
        (
            "<root BTCPP_format=\"4\"><include path=\"b.xml\"/></root>",
            "include `b.xml`: not found",
        ),
        ("<root BTCPP_format=\"4\"><include/></root>", "<include> without a path"),
        (
            "<root BTCPP_format=\"4\"><TreeNodesModel><Foo ID=\"x\"/></TreeNodesModel></root>",
            "<Foo> in TreeNodesModel",
        ),
        ("<!DOCTYPE root [<!ENTITY a \"b\">]><root/>", "document type"),
        ("<root BTCPP_format=\"4\" xmlns:x=\"y\"/>", "namespace"),
    ] {
        let errors = errors_of(text);
        assert!(errors.iter().any(|error| error.contains(part)), "{text}: {errors:#?}");
    }
}

#[test]
fn bytes_that_are_not_text_are_refused_with_their_line() {
    let result = build("bad.xml", b"<root>\n\xff</root>", &registry(), None, &mut |_, _| {
        Err(String::new())
    });
    assert!(
        result
            .unwrap_err()
            .to_string()
            .starts_with("bad.xml:2:1: bytes that are not text")
    );
}

#[test]
fn trees_that_contain_one_another_are_refused() {
    let cycle = "<root BTCPP_format=\"4\" main_tree_to_execute=\"A\">
<BehaviorTree ID=\"A\"><SubTree ID=\"B\"/></BehaviorTree>
<BehaviorTree ID=\"B\"><Sequence><T/><SubTree ID=\"C\"/></Sequence></BehaviorTree>
<BehaviorTree ID=\"C\"><SubTree ID=\"B\"/></BehaviorTree>
<BehaviorTree ID=\"D\"><SubTree ID=\"D\"/></BehaviorTree>
</root>";
    let errors = errors_of(cycle);
    assert_eq!(
        errors,
        [
            "bad.xml:4:22: trees contain one another: B > C > B: expected SubTrees without a cycle",
            "bad.xml:5:22: trees contain one another: D > D: expected SubTrees without a cycle",
        ]
    );
}

/// Trees T0 … Tn, each using the next twice.
fn doubling(levels: usize) -> String {
    let mut text = String::from("<root BTCPP_format=\"4\" main_tree_to_execute=\"T0\">");
    for level in 0..levels {
        let next = level + 1;
        text += &format!(
            "<BehaviorTree ID=\"T{level}\"><Sequence><SubTree ID=\"T{next}\"/><SubTree ID=\"T{next}\"/></Sequence></BehaviorTree>"
        );
    }
    text + &format!("<BehaviorTree ID=\"T{levels}\"><T/></BehaviorTree></root>")
}

#[test]
fn exponential_expansion_is_refused_without_expanding() {
    assert!(errors_of(&doubling(5)).is_empty());
    let errors = errors_of(&doubling(100));
    assert_eq!(errors.len(), 1);
    assert!(
        errors[0].contains("nodes with its SubTrees: expected at most 10000"),
        "{errors:?}"
    );
}

#[test]
fn depth_size_and_number_are_bounded() {
    let deep = |levels: usize| format!("{}<T/>{}", "<Inverter>".repeat(levels), "</Inverter>".repeat(levels));
    assert!(in_tree(&deep(255)).is_empty());
    assert!(in_tree(&deep(256))[0].contains("257 levels with its SubTrees"));
    assert!(in_tree(&deep(257))[0].contains("too deeply"));
    assert!(in_tree(&deep(10_000))[0].contains("too deeply"));
    // Deep only after its SubTrees are unfolded.
    let chain: String = (0..300)
        .map(|level| {
            format!(
                "<BehaviorTree ID=\"T{level}\"><SubTree ID=\"T{}\"/></BehaviorTree>",
                level + 1
            )
        })
        .collect();
    let chain =
        format!("<root main_tree_to_execute=\"T0\">{chain}<BehaviorTree ID=\"T300\"><T/></BehaviorTree></root>");
    assert!(errors_of(&chain)[0].contains("levels with its SubTrees"));
    let wide = format!("<Sequence>{}</Sequence>", "<T/>".repeat(20_000));
    assert!(in_tree(&wide)[0].contains("20001 nodes"));
    let huge = " ".repeat((4 << 20) + 1);
    assert!(errors_of(&huge)[0].contains("expected at most 4194304 bytes"));
}

#[test]
fn so_many_errors_are_told_and_the_rest_counted() {
    let text = format!(
        "<root><BehaviorTree ID=\"A\"><Sequence>{}</Sequence></BehaviorTree></root>",
        "<Foo/>".repeat(500)
    );
    let limits = Limits {
        errors: 7,
        ..Limits::default()
    };
    let errors = build_within(
        "bad.xml",
        text.as_bytes(),
        &registry(),
        None,
        &mut |_, _| Err(String::new()),
        limits,
    )
    .unwrap_err();
    assert_eq!((errors.errors.len(), errors.more), (7, 493));
    assert!(errors.to_string().ends_with("… and 493 more"));
}

#[cfg(feature = "nav2")]
#[test]
fn ports_that_exclude_one_another_cannot_share_an_entry() {
    use crate::simulate;
    let text = br#"<root><BehaviorTree ID="A"><Sequence>
<ComputePathToPose goal="{g}" path="{p}"/><Wait wait_duration="{p}"/></Sequence></BehaviorTree></root>"#;
    let errors = build("bad.xml", text, &simulate::registry(), None, &mut |_, _| {
        Err(String::new())
    })
    .unwrap_err();
    let told = "bad.xml:2:49: port `wait_duration` and the port at bad.xml:2:31 share an entry: expected the same type, not a number and a Path";
    assert_eq!(errors.to_string(), told);
    // Also checked alone, reported once although the tree is unfolded twice, and beside other errors.
    let text = String::from_utf8_lossy(text).replace("<root>", "<root main_tree_to_execute=\"M\">").replace(
        "</root>",
        "<BehaviorTree ID=\"M\"><Sequence><SubTree ID=\"A\"/><SubTree ID=\"A\"/><Sleep/></Sequence></BehaviorTree></root>",
    );
    let none = &mut |_: &str, _: &str| Err(String::new());
    let registry = simulate::registry();
    let checked = check("bad.xml", text.as_bytes(), &registry, none, Limits::default()).unwrap_err();
    let built = build("bad.xml", text.as_bytes(), &registry, None, none).unwrap_err();
    for errors in [checked, built] {
        assert_eq!(errors.errors.len(), 2, "{errors}");
        assert!(errors.to_string().contains("`Sleep` without port") && errors.to_string().contains(told));
    }
}

#[cfg(feature = "nav2")]
#[test]
fn literals_of_poses_and_lists_are_checked_and_names_are_told() {
    use crate::simulate;
    let of = |node: &str| {
        let text = format!("<root><BehaviorTree ID=\"A\">{node}</BehaviorTree></root>");
        let none = &mut |_: &str, _: &str| Err(String::new());
        let checked = check("p.xml", text.as_bytes(), &simulate::registry(), none, Limits::default());
        checked
            .map(|summary| summary.warnings)
            .map_err(|errors| errors.to_string())
    };
    assert_eq!(
        of("<ArePosesNear ref_pose=\"1;x\" target_pose=\"0;0;0\"/>"),
        Err("p.xml:1:42: port `ref_pose` is `1;x`: expected a PoseStamped: `x;y`, `x;y;yaw` (radians within a full turn), the name of a place, or JSON".to_owned())
    );
    assert_eq!(of("<ComputePathToPose goal=\"1;2\"/>"), Ok(Vec::new()));
    assert_eq!(
        of("<ComputePathToPose goal=\"hello\"/>"),
        Ok(vec![
            "p.xml:1:47: port `goal`: `hello` is taken for the name of a place".to_owned()
        ])
    );
    assert!(of("<ComputePathThroughPoses goals=\"1;2|3\"/>").is_err());
    assert!(of("<ComputePathToPose goal=\"1;2;90\"/>").is_err());
    for (node, told) in [
        (
            "<Spin spin_dist=\"90\"/>",
            "port `spin_dist` is 90: more than a full turn; 90 degrees are 1.571 rad",
        ),
        (
            "<Wait wait_duration=\"-1\"/>",
            "port `wait_duration` is -1: expected seconds, not negative",
        ),
    ] {
        let warnings = of(node).unwrap();
        assert!(
            matches!(&warnings[..], [warning] if warning.ends_with(told)),
            "{warnings:?}"
        );
    }
    assert_eq!(of("<Spin spin_dist=\"-6.28\"/>"), Ok(Vec::new()));
}

#[test]
fn includes_are_read_once_and_may_include_one_another() {
    let main = "<root BTCPP_format=\"4\" main_tree_to_execute=\"A\"><include path=\"b.xml\"/><include path=\"b.xml\"/><BehaviorTree ID=\"A\"><SubTree ID=\"B\"/></BehaviorTree></root>";
    let other = "<root BTCPP_format=\"4\"><include path=\"a.xml\"/><BehaviorTree ID=\"B\"><T/></BehaviorTree></root>";
    let mut asked = Vec::new();
    let built = build("a.xml", main.as_bytes(), &registry(), None, &mut |from, path| {
        asked.push(format!("{from}>{path}"));
        Ok((
            path.to_owned(),
            if path == "b.xml" { other } else { main }.as_bytes().to_vec(),
        ))
    });
    assert_eq!(built.unwrap().len(), 2);
    assert_eq!(asked, ["a.xml>b.xml", "a.xml>b.xml", "b.xml>a.xml"]);
}

#[test]
fn files_that_include_one_another_are_named() {
    let file = |other: &str| format!("<root><include path=\"{other}\"/></root>").into_bytes();
    let mut include = |_: &str, path: &str| Ok((path.to_owned(), file(if path == "b" { "c" } else { "b" })));
    let summary = check("a", &file("b"), &registry(), &mut include, Limits::default()).unwrap();
    assert_eq!(
        summary.warnings,
        ["b:1:16: files include one another: b > c > b: each is read once"]
    );
}

#[test]
fn several_trees_of_which_none_is_the_main_one_are_worth_a_word() {
    let text = "<root><BehaviorTree ID=\"A\"><T/></BehaviorTree><BehaviorTree ID=\"B\"><T/></BehaviorTree></root>";
    let none = &mut |_: &str, _: &str| Err(String::new());
    let summary = check("t", text.as_bytes(), &registry(), none, Limits::default()).unwrap();
    assert!(summary.warnings[0].contains("no main_tree_to_execute"));
}

#[test]
fn endless_includes_end() {
    let mut number = 0;
    let built = build(
        "0",
        b"<root><include path=\"next\"/></root>",
        &registry(),
        None,
        &mut |_, _| {
            number += 1;
            Ok((number.to_string(), b"<root><include path=\"next\"/></root>".to_vec()))
        },
    );
    assert!(built.unwrap_err().to_string().contains("too many includes"));
    assert_eq!(number, 64);
}

#[test]
fn a_model_makes_a_node_known_but_not_runnable() {
    let text = b"<root><TreeNodesModel><Action ID=\"Grab\"><input_port name=\"force\" type=\"double\" default=\"2\"/></Action></TreeNodesModel>
<BehaviorTree ID=\"A\"><Grab force=\"x\"/></BehaviorTree></root>";
    let none = &mut |_: &str, _: &str| Err(String::new());
    let errors = check("m.xml", text, &registry(), none, Limits::default()).unwrap_err();
    assert_eq!(errors.to_string(), "m.xml:2:28: port `force` is `x`: expected a number");
    let good = String::from_utf8(text.to_vec()).unwrap().replace("\"x\"", "\"1\"");
    let summary = check("m.xml", good.as_bytes(), &registry(), none, Limits::default()).unwrap();
    assert_eq!(summary.trees.get("A"), Some(&1));
    assert_eq!(
        summary.warnings,
        ["m.xml:2:22: nothing here implements `Grab`: a mission would refuse it"]
    );
    let errors = build("m.xml", good.as_bytes(), &registry(), None, none).unwrap_err();
    assert!(errors.to_string().contains("nothing here implements `Grab`"));
    let near = good.replace("Grab", "Sequense");
    let errors = build("m.xml", near.as_bytes(), &registry(), None, none).unwrap_err();
    assert_eq!(
        errors.to_string(),
        "m.xml:2:22: nothing here implements `Sequense`: expected a node that this program can run, perhaps `Sequence`"
    );
}

#[test]
fn copies_of_long_attributes_are_bounded_before_they_are_made() {
    let long = "x".repeat(1 << 20);
    let uses = "<SubTree ID=\"Long\"/>".repeat(50);
    let text = format!(
        "<root main_tree_to_execute=\"A\"><BehaviorTree ID=\"A\"><Sequence>{uses}</Sequence></BehaviorTree>
        <BehaviorTree ID=\"Long\"><T name=\"{long}\"/></BehaviorTree></root>"
    );
    assert!(errors_of(&text)[0].contains("bytes of attributes with its SubTrees"));
    // Nor are messages as long as the text they quote.
    let errors = errors_of(&format!("<root><BehaviorTree ID=\"A\"><{long}/></BehaviorTree></root>"));
    assert!(errors[0].len() < 1_000);
}

/// The files that cost most to refuse, each of the largest size that is read at all.
#[test]
fn the_files_that_cost_most_are_refused() {
    let fill = |piece: &str| {
        let body = piece.repeat((4 << 20) / piece.len() - 50);
        format!("<root><BehaviorTree ID=\"A\"><Sequence>{body}</Sequence></BehaviorTree></root>")
    };
    let name = "a".repeat(40);
    for (what, text) in [
        ("unknown nodes", fill(&format!("<{name}/>"))),
        ("unknown trees", fill(&format!("<SubTree ID=\"{name}\"/>"))),
        ("wrong ports", fill("<T a='1' b='' c='' d='' e='' f=''/>")),
        ("texts", fill("x<T/>")),
        ("open tags", "<a>".repeat(1 << 20)),
        ("angles", "<".repeat(4 << 20)),
        ("comments", fill("<!---->")),
        ("scripts", fill("<Script code='a+a+a+a+a+a+a+a+a+a+a+a+a+a+a+a+a+a'/>")),
    ] {
        // A quadratic algorithm would take minutes, and be noticed; no time is asserted, because the machine may be busy.
        assert!(!errors_of(&text).is_empty(), "{what}");
    }
}

#[test]
fn the_deepest_tree_and_the_longest_script_fit_the_stack() {
    let sum = format!("1{}", "+1".repeat(210));
    let brackets = format!("{}1{}", "(".repeat(32), ")".repeat(32));
    let leaf = format!("<ScriptCondition code=\"{sum} &gt; {brackets}\"/>");
    for decorator in [
        "Inverter",
        "Sequence",
        "RetryUntilSuccessful num_attempts=\"2\"",
        "Parallel",
    ] {
        let name = decorator.split(' ').next().unwrap();
        let text = format!(
            "<root><BehaviorTree ID=\"A\">{}{leaf}{}</BehaviorTree></root>",
            format!("<{decorator}>").repeat(511),
            format!("</{name}>").repeat(511)
        );
        let limits = Limits {
            depth: usize::MAX,
            ..Limits::default()
        };
        let none = &mut |_: &str, _: &str| Err(String::new());
        let mut tree = build_within("deep.xml", text.as_bytes(), &registry(), None, none, limits).unwrap();
        let status = tree.tick(std::time::Duration::ZERO, &mut World::default()).unwrap();
        assert!(status.is_completed());
        assert!(tree.render().lines().count() == 512);
    }
}
