//! The `lsdc` program: arguments, settings, and all terminal output.
//!
//! What it does is in the libraries below it: `lsdc-core` completes depth, `lsdc-files` and `lsdc-recordings` read and
//! write files, `lsdc-eval` measures, `lsdc-train` trains, `lsdc-paper` repeats the experiments of the paper (Fang et al.,
//! "Depth-Independent Depth Completion via Least Square Estimation"), `lsdc-serve` answers over HTTP.
//!
//! ```
//! let config = lsdc::config::Config::load(None, &["eval.seeds=3".to_owned()])?;
//! assert_eq!(config.eval.seeds, 3);
//! # Ok::<(), lsdc_files::error::Error>(())
//! ```

pub mod cli;
pub mod config;
#[allow(unsafe_code)]
pub mod process;
