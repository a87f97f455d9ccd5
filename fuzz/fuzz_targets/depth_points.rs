#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| endoscape_fuzz::parse("depth_points", bytes));
