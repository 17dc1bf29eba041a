#![no_main]

#[path = "../cases.rs"]
#[allow(dead_code, reason = "each target runs one of the cases")]
mod cases;

libfuzzer_sys::fuzz_target!(|data: &[u8]| cases::lines(data));
