//! Reference of the command line. A page of the docs, generated from the declared commands, arguments and options, so that every change to
//! them shows in it.

use clap::{Arg, Command};

/// Options of every command, described once.
const EVERYWHERE: [&str; 5] = ["help", "version", "log_format", "verbose", "quiet"];

/// The page.
pub(super) fn page(mut root: Command) -> String {
    root.build();
    let mut text = "# Commands\n\n\
        Every command, with its arguments and options; `zenav COMMAND --help` tells the same with examples. \
        Names, options and defaults stay: scripts may rely on them. \
        `--log-format text|json`, `-v` (`--verbose`) and `-q` (`--quiet`) go with each.\n"
        .to_owned();
    for command in visible(&root) {
        describe(command, "zenav", 2, &[], &mut text);
    }
    text
}

fn visible(command: &Command) -> impl Iterator<Item = &Command> {
    let subcommands = command.get_subcommands();
    subcommands.filter(|command| !command.is_hide_set() && command.get_name() != "help")
}

fn describe(command: &Command, above: &str, level: usize, told_above: &[&str], text: &mut String) {
    let name = format!("{above} {}", command.get_name());
    let marks = "#".repeat(level);
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    text.push_str(&format!("\n{marks} {name}\n\n{about}\n"));
    let own = |arg: &&Arg| {
        let id = arg.get_id().as_str();
        // An inherited option is listed with the parent command.
        let is_inherited = arg.is_global_set() && told_above.contains(&id);
        !(arg.is_hide_set() || is_inherited || EVERYWHERE.contains(&id))
    };
    let rows: Vec<String> = command.get_arguments().filter(own).map(row).collect();
    let globals = command.get_arguments().filter(|arg| arg.is_global_set());
    let mut told: Vec<&str> = globals.map(|arg| arg.get_id().as_str()).collect();
    told.extend(told_above);
    if !rows.is_empty() {
        text.push_str("\n| | | default |\n|---|---|---|\n");
        text.push_str(&rows.concat());
    }
    for subcommand in visible(command) {
        describe(subcommand, &name, level + 1, &told, text);
    }
}

fn row(arg: &Arg) -> String {
    let variable = arg
        .get_env()
        .map_or_else(String::new, |name| format!(" (also `{}`)", name.to_string_lossy()));
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default() + &variable;
    let default: Vec<String> = arg
        .get_default_values()
        .iter()
        .map(|value| format!("`{}`", value.to_string_lossy()))
        .collect();
    // A switch takes no value, so it has no default.
    let default = if arg.get_action().takes_values() {
        default.join(" ")
    } else {
        String::new()
    };
    let cell = |text: &str| text.replace('|', "\\|");
    format!(
        "| `{}` | {} | {} |\n",
        arg.to_string().replace('|', "\\|"),
        cell(&help),
        cell(&default)
    )
}
