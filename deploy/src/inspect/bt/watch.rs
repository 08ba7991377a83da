//! `zenav bt watch`: draws the tree that a mission runs, with the status of every node.

use std::collections::BTreeMap;
use std::io::IsTerminal as _;
use std::time::Duration;

use zenav_protocol::messages::{MissionStatus, NodeStatus};
use zenav_protocol::topics;

use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::diagnosis;
use crate::output::{self, Format};

pub(super) fn watch(robot: &RobotArgs, once: bool, format: Format) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let mut missions = bus.latest(&topics::MISSION, &[&robot])?;
        let live = std::io::stdout().is_terminal() && format == Format::Table && !once;
        let mut drawn = 0;
        let mut last = String::new();
        loop {
            let patience = if last.is_empty() { patience } else { Duration::MAX };
            let received = tokio::select! {
                biased;
                _ = tokio::signal::ctrl_c() => return Ok(exit_code::INTERRUPTED),
                received = tokio::time::timeout(patience, missions.next()) => received,
            };
            let status = match received {
                Ok(Some(received)) => received.message,
                Ok(None) => return Err(Failure::new(exit_code::CANNOT_CONNECT, "the bus was closed")),
                Err(_) => {
                    return Err(Failure::new(
                        exit_code::TIMEOUT,
                        format!(
                            "no word from {} in time: does a mission run?",
                            topics::MISSION.key(&[&robot])
                        ),
                    ));
                }
            };
            // A window of size zero is one whose size is unknown.
            let rows = crossterm::terminal::size()
                .ok()
                .map(|(_, rows)| usize::from(rows))
                .filter(|rows| live && *rows > 3);
            let text = picture(&status, live, rows);
            if text == last && format == Format::Table {
                continue;
            }
            if live {
                // Overwrites the previous drawing.
                let up = if drawn > 0 {
                    format!("\x1b[{drawn}A\x1b[J")
                } else {
                    String::new()
                };
                output::line(&format!("{up}{text}"));
                drawn = text.lines().count();
            } else {
                output::value(if once { format } else { format.streamed() }, &status, |_| text.clone())?;
            }
            last = text;
            if once {
                return Ok(exit_code::OK);
            }
        }
    })
}

/// A mission's tree, one node per row. If the tree has more nodes than fit into `rows`, only the most informative ones are shown.
fn picture(status: &MissionStatus, colors: bool, rows: Option<usize>) -> String {
    let goal = status.goal_id.as_deref().unwrap_or("no goal");
    let leads = match status.leads {
        true => format!("leads, {}", diagnosis::standbys(status)),
        false => "does not lead".to_owned(),
    };
    let mut lines = vec![
        format!("{} {leads} (epoch {})", status.holder, status.epoch),
        format!(
            "tree {}: {goal}, {} waiting",
            status.tree.as_deref().unwrap_or("none"),
            status.queued
        ),
    ];
    let shown = rows.map_or(usize::MAX, |rows| rows.saturating_sub(4));
    let least = shown_from(&status.nodes, shown);
    let mut depths = BTreeMap::new();
    let mut left_out = 0;
    for (at, node) in status.nodes.iter().enumerate() {
        // Document order: a parent comes before its children.
        let depth = node
            .parent
            .and_then(|parent| depths.get(&parent))
            .map_or(0, |depth: &usize| depth + 1);
        depths.insert(node.uid, depth);
        if (weight(node), at) <= least {
            lines.push(row(node, depth, colors));
        } else {
            left_out += 1;
        }
    }
    if left_out > 0 {
        lines.push(format!("… {left_out} more on a taller terminal"));
    }
    lines.join("\n")
}

/// Display order of a node's status: 0 (running) is the most informative.
fn weight(node: &NodeStatus) -> u8 {
    match node.status.as_str() {
        "RUNNING" => 0,
        "FAILURE" => 1,
        "SUCCESS" => 2,
        _ => 3,
    }
}

/// Weight and index of the last node that is shown if at most `most` nodes are.
fn shown_from(nodes: &[NodeStatus], most: usize) -> (u8, usize) {
    let mut order: Vec<(u8, usize)> = nodes.iter().enumerate().map(|(at, node)| (weight(node), at)).collect();
    order.sort_unstable();
    let last = most.min(order.len()).checked_sub(1);
    last.and_then(|last| order.get(last).copied()).unwrap_or_default()
}

fn row(node: &NodeStatus, depth: usize, colors: bool) -> String {
    let mark = match node.status.as_str() {
        "RUNNING" => ('▶', 33),
        "SUCCESS" => ('✓', 32),
        "FAILURE" => ('✗', 31),
        "SKIPPED" => ('-', 90),
        _ => ('·', 90),
    };
    let id = if node.id == node.name {
        String::new()
    } else {
        format!(" [{}]", node.id)
    };
    let feedback = if node.feedback.is_empty() {
        String::new()
    } else {
        format!("  {}", node.feedback)
    };
    // A multi-line feedback, or one with terminal escape codes, must not break the picture.
    let text: String = format!("{}{id}{feedback}", node.name)
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let indent = "  ".repeat(depth.min(40));
    if colors {
        format!("{indent}\x1b[{}m{}\x1b[0m {text}", mark.1, mark.0)
    } else {
        format!("{indent}{} {text}", mark.0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use zenav_protocol::messages::GoalFeedback;
    use zenav_protocol::time::Stamp;

    use super::*;

    #[test]
    fn a_mission_is_drawn_by_depth() {
        let node = |uid, parent, name: &str, status: &str| NodeStatus {
            uid,
            parent,
            name: name.into(),
            id: name.into(),
            status: status.into(),
            feedback: String::new(),
            last: String::new(),
            ports: std::collections::BTreeMap::new(),
        };
        let status = MissionStatus {
            stamp: Stamp(0),
            holder: "m".into(),
            leads: true,
            epoch: 2,
            goal_id: None,
            tree: Some("T".into()),
            nodes: vec![
                node(1, None, "Sequence", "RUNNING"),
                node(2, Some(1), "Wait", "SUCCESS"),
                node(3, Some(1), "Drive\n", "RUNNING"),
            ],
            feedback: GoalFeedback::default(),
            queued: 0,
            standbys: Vec::new(),
        };
        let low = picture(&status, false, Some(6));
        assert_eq!(
            low.lines().skip(2).collect::<Vec<_>>(),
            ["▶ Sequence", "  ▶ Drive ", "… 1 more on a taller terminal"]
        );
        let drawn = picture(&status, false, None);
        assert_eq!(
            drawn.lines().skip(2).collect::<Vec<_>>(),
            ["▶ Sequence", "  ✓ Wait", "  ▶ Drive "]
        );
    }
}
