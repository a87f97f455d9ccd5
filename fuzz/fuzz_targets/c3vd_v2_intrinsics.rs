#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| endoscape_fuzz::parse("c3vd_v2_intrinsics", bytes));
