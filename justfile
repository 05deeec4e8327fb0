# Short names for the commands in README.md; nothing here that cargo alone cannot do.

# List the recipes.
default:
    @just --list

# The main job.
quickstart:
    cargo run --release -- run pipelines/quickstart.yaml

# All tests, as CI runs them.
test:
    cargo test --release

# The slow suites too: the quickstart's results among them.
test-slow:
    TAUFLOW_SLOW=1 cargo test --release

# Formatting and lints.
lint:
    cargo fmt --all --check
    cargo clippy --release --workspace --all-targets -- -D warnings
