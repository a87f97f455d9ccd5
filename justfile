# Everything CI checks, and what else is worth a look before a change goes out.

# fmt, lints, docs and tests, as `.ci/run` does them
check: fmt lint docs test

fmt:
    cargo fmt --all --check

lint:
    cargo clippy --workspace --all-targets --locked -- -D warnings

docs:
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked

test:
    cargo test --workspace --locked

# ORB SLAM, which default builds leave out (docs/decisions/007)
test-orb:
    cargo clippy -p endoscape-baselines --all-targets --features orb --locked -- -D warnings
    cargo test -p endoscape-baselines --features orb --locked

# networks, training and our own kernels on Vulkan; Mesa's software driver will do (docs/decisions/008, 009)
test-vulkan:
    cargo test -p endoscape-cli --features vulkan --test vulkan --locked

# slow tests as well
test-all:
    cargo test --workspace --locked -- --include-ignored

# recordings for the Rerun viewer: some 170 crates more, and Burn built once again
test-rerun:
    cargo clippy -p endoscape-report -p endoscape-cli --all-targets --features endoscape-cli/rerun --locked -- -D warnings
    cargo test -p endoscape-report -p endoscape-cli --test recording --test record --features endoscape-cli/rerun --locked

# licences, sources, advisories, spelling (needs cargo-deny and typos)
extra:
    cargo deny check
    typos

# one minute of every fuzz target (needs cargo-fuzz and a nightly toolchain)
fuzz seconds="60":
    for target in $(cargo fuzz list); do cargo +nightly fuzz run "$target" -- -max_total_time={{seconds}} || exit 1; done
