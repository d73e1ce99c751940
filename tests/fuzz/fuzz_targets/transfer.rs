#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| lightkiln_fuzz::targets::run("transfer", bytes));
