//! The program `tauflow`; see [`tauflow::cli`].

fn main() -> std::process::ExitCode {
    tauflow::cli::main()
}
