//! The program `tauflow`; see [`tauflow::cli`].

/// Keeps the memory of large tensors, which glibc's gives back to the kernel after each operator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    tauflow::cli::main()
}
