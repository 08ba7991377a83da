//! The `zenav` command as a binary of this package, so that tests can start it.

fn main() -> std::process::ExitCode {
    zenav::main()
}
