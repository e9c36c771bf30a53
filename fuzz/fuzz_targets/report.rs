//! Reports that are read back to be joined.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_eval::report::EvaluationReport;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = EvaluationReport::from_json(text);
    }
});
