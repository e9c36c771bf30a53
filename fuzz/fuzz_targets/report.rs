//! Reports that are read to be merged.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_eval::report::EvaluationReport;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = EvaluationReport::from_json(text);
    }
});
