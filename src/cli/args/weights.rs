//! Arguments of `lsdc weights`.

use super::values::precision;
use clap::{Args as ClapArgs, Subcommand};
#[cfg(feature = "download")]
use lsdc_weights::KNOWN;
use lsdc_weights::Precision;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum WeightsCommand {
    /// List the weights of the program, and the licences of what they were trained on.
    List {
        /// Print only the folder of installed weights; the environment variable `LSDC_WEIGHTS` names another.
        #[arg(long)]
        print_folder: bool,
    },
    /// Download what weights of the program are built on.
    #[cfg(feature = "download")]
    Get(Get),
    /// Install what weights of the program are built on from its published file.
    Add(Add),
    /// Describe weights: network, input, fit, training settings, accuracy, licences, and what they were made from.
    Info {
        /// Weights file, or a name shown by `list` [default: the weights named `default`].
        file: Option<PathBuf>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write weights in another precision.
    Convert(Convert),
    /// Write the network of weights as an ONNX graph, for ONNX Runtime and other runtimes.
    Export(ExportNetwork),
}

#[cfg(feature = "download")]
#[derive(Debug, ClapArgs)]
#[command(
    after_help = "An interrupted download goes on where it was. What arrives is checked, wherever it \
                        comes from, and kept in half precision in the folder that \
                        `lsdc weights list --print-folder` prints."
)]
pub(in crate::cli) struct Get {
    /// Weights that `list` shows as not installed.
    #[arg(value_parser = KNOWN.map(|known| known.weights))]
    pub(in crate::cli) name: String,
    /// Where to download from, http or https [default: where the file was published].
    #[arg(long, value_name = "URL")]
    pub(in crate::cli) url: Option<String>,
    /// Download again what is installed.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "For `anything`: `depth_anything_v2_vits.pth`, or `model.safetensors` of \
                        Depth-Anything-V2-Small-hf. It is recognised by its values and kept in half precision \
                        in the folder that `lsdc weights list --print-folder` prints."
)]
pub(in crate::cli) struct Add {
    /// The published file, of whatever name.
    pub(in crate::cli) file: PathBuf,
    /// Replace what is installed.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Convert {
    /// Weights file, or a name shown by `list`.
    pub(in crate::cli) input: PathBuf,
    /// Weights file to write.
    pub(in crate::cli) output: PathBuf,
    /// Precision of the network's parameters: f16 or f32.
    #[arg(long, value_parser = precision(), default_value = "f16", value_name = "TYPE")]
    pub(in crate::cli) precision: Precision,
    /// Replace the file if it exists.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "The input `image` is [batch, 3, height, width], red, green and blue from 0 to 1; height and width \
                        are free. The outputs are `basis`, the basis functions, and `affinities`, of each pixel with its \
                        right and lower neighbour. Python fits them to depths: `completer.scene(image, outputs=...)`. \
                        `anything` cannot be exported."
)]
pub(in crate::cli) struct ExportNetwork {
    /// Weights file, or a name shown by `list`.
    pub(in crate::cli) input: PathBuf,
    /// ONNX file to write (opset 13, f32).
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) onnx: PathBuf,
    /// Replace the file if it exists.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}
