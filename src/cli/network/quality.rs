//! The work per completion that `--quality` and `--encoder-side` name.

use crate::cli::ui;
use lsdc_core::{Completer, DepthAnything, Quality};
use lsdc_files::error::{Error, Result};
use lsdc_weights::names_no_network;
use std::path::Path;

/// The completer of these weights at a quality, whose encoder reads images of this size.
///
/// # Errors
/// More work that would change nothing, and sizes out of range.
pub(in crate::cli) fn at_quality(
    completer: &Completer,
    quality: Quality,
    encoder_side: Option<usize>,
    weights: Option<&Path>,
) -> Result<Completer> {
    if quality == Quality::Best && names_no_network(weights) {
        return Err(Error::config(
            "`--quality best` would change nothing: without a network, the mirror image has the mirrored depths",
        )
        .hint("leave it out, or give other `--weights`"));
    }
    with_encoder_side(completer.with_quality(quality), encoder_side)
}

/// The completer whose encoder reads images of this size.
///
/// # Errors
/// A size out of range, and weights without an encoder.
pub(in crate::cli) fn with_encoder_side(
    completer: Completer,
    side: Option<usize>,
) -> Result<Completer> {
    let Some(side) = side else {
        return Ok(completer);
    };
    let completer = completer.with_encoder_side(side)?;
    if side != DepthAnything::SHORT_SIDE {
        ui::say(&format!(
            "--encoder-side {side}: standard deviations were learned with {}",
            DepthAnything::SHORT_SIDE
        ));
    }
    Ok(completer)
}
