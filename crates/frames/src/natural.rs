//! Natural order of names: `2` before `10`.
