//! The `zenav` command.

fn main() -> std::process::ExitCode {
    zenav::main()
}
