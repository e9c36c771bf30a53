//! Arguments about the pretrained encoder of the weights.

use clap::Args as ClapArgs;
#[cfg(any(feature = "serve", feature = "node"))]
use clap::builder::{PossibleValuesParser, TypedValueParser};
#[cfg(any(feature = "serve", feature = "node"))]
use lsdc_eval::predict::GuideSpec;

/// What the pretrained encoder of the weights reads.
#[derive(Clone, Copy, Debug, ClapArgs)]
pub(in crate::cli) struct EncoderInput {
    /// Size of the image that the pretrained encoder of the weights reads: the shorter side of one of 4:3 with as many pixels,
    /// from 252 to 518 [default: 336].
    #[arg(
        id = "encoder_side",
        long = "encoder-side",
        value_name = "PIXELS",
        help_heading = "Network",
        hide_short_help = true
    )]
    pub(in crate::cli) side: Option<usize>,
}

/// How completers use the pretrained encoder of the weights.
#[cfg(any(feature = "serve", feature = "node"))]
#[derive(Clone, Debug, ClapArgs)]
pub(in crate::cli) struct PretrainedEncoder {
    #[command(flatten)]
    pub(in crate::cli) input: EncoderInput,
    /// `none`: without the guide that weights on an encoder have by default, from its depth head.
    #[arg(long, value_parser = no_guide(), value_name = "none", help_heading = "Network", hide_short_help = true)]
    pub(in crate::cli) guide: Option<GuideSpec>,
}

/// No guide, by its name.
#[cfg(any(feature = "serve", feature = "node"))]
fn no_guide() -> impl TypedValueParser<Value = GuideSpec> {
    PossibleValuesParser::new(["none"]).map(|_| GuideSpec::None)
}
