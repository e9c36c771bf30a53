//! The quality that `--quality` names.

use lsdc_core::{Completer, Quality};
use lsdc_files::error::{Error, Result};
use lsdc_weights::names_no_network;
use std::path::Path;

/// The completer of these weights at a quality.
///
/// # Errors
/// More work that would change nothing.
pub(in crate::cli) fn at_quality(
    completer: &Completer,
    quality: Quality,
    weights: Option<&Path>,
) -> Result<Completer> {
    if quality == Quality::Best && names_no_network(weights) {
        return Err(Error::config(
            "`--quality best` would change nothing: without a network, the mirror image has the mirrored depths",
        )
        .hint("leave it out, or give other `--weights`"));
    }
    Ok(completer.with_quality(quality))
}
