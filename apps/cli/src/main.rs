//! The `endoscape` command.

fn main() {}
