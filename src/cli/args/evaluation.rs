//! Arguments of `eval` and `export`.

use super::values::{head, interpolation, named_file, named_folder, split, typed};
use super::{Draws, FitFlags, Model, Settings, Source};
use clap::Args as ClapArgs;
use lsdc_eval::data::{Shard, Split};
use lsdc_eval::evaluation::EvalConfig;
use lsdc_eval::predict::{GuideSpec, Method};
use lsdc_eval::sampling::{HoldOut, Interpolation, Noise, Pattern};
use lsdc_weights::ResizeLayer;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "`lsdc eval --help` shows every option.",
    after_long_help = "See docs/evaluation.md for details."
)]
pub(in crate::cli) struct Eval {
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    #[command(flatten)]
    pub(in crate::cli) draws: Draws,
    /// Sparse points: N, exactly:N, bernoulli:N, bernoulli-all:N, grid:STEP, lines:N, corners:N,
    /// half:N, clusters:N, scanner:BEAMS (4 to 128), given, files:DIR [default: as in the protocol].
    #[arg(long, value_parser = typed::<Pattern>, value_name = "POINTS", help_heading = "Protocol")]
    pub(in crate::cli) points: Option<Pattern>,
    /// Hold out part of each frame, which is scored and never given: ring:K (all rings of a laser scanner but every K-th),
    /// clusters:N (N square blocks around measured pixels) or region (a rectangle of half the width and height).
    #[arg(long, value_parser = typed::<HoldOut>, value_name = "LAW", help_heading = "Protocol", hide_short_help = true)]
    pub(in crate::cli) hold_out: Option<HoldOut>,
    /// Corrupt the points: added:SHARE:METRES (add up to METRES to a share of them), outliers:SHARE (replace a
    /// share of them), moved:LEAST:MOST (move each by so many pixels), region:SHARE:METRES (add METRES in a share
    /// of the image) or stereo:METRES (noise of METRES x the square of the depth).
    #[arg(long, value_parser = typed::<Noise>, value_name = "NOISE", help_heading = "Protocol", hide_short_help = true)]
    pub(in crate::cli) noise: Option<Noise>,
    /// How ground-truth depths are resized [default: as in the protocol].
    #[arg(long, value_parser = interpolation(), help_heading = "Protocol", hide_short_help = true)]
    pub(in crate::cli) depth_resize: Option<Interpolation>,
    /// Methods to compare, on the same points [default: lsdc,linear]: lsdc (Fang et al., Depth-Independent Depth Completion
    /// via Least Square Estimation, with a field), nearest, linear (Delaunay), linear-inverse (the same of inverse depth), idw
    /// (Shepard 1968), tps (Duchon 1977), wls (Farbman et al. 2008), levin (Levin et al. 2004), steering (Takeda et al. 2007), ip-basic (Ku et al. 2018).
    #[cfg_attr(
        feature = "train",
        doc = "With weights of their own, given by --weights: s2d (Ma and Karaman, Sparse-to-Dense, ICRA 2018), cspn (Cheng, Wang and Yang, ECCV 2018), lsk (Liu et al., Learning Steering Kernels, TIP 2021)."
    )]
    #[arg(long, value_parser = typed::<Method>, value_delimiter = ',', value_name = "NAMES", help_heading = "Methods")]
    pub(in crate::cli) method: Vec<Method>,
    /// Also measure a system trained here, from its weights file: one of s2d, cspn or lsk; may be repeated.
    #[arg(long, value_parser = named_file, value_name = "[NAME=]FILE", help_heading = "Methods", hide_short_help = true)]
    #[cfg_attr(not(feature = "train"), arg(hide = true))]
    pub(in crate::cli) system: Vec<(Option<String>, PathBuf)>,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// Give `lsdc` dense predictions of other programs as guides: a folder of files with the names of the frames, and
    /// what they hold (depth, disparity or log), as for `complete`. They belong to the frames that `lsdc export` writes.
    /// Or depth-anything[:SIDE] or none, as for `complete`.
    #[arg(long, value_parser = typed::<GuideSpec>, value_name = "DIR[:KIND]", help_heading = "Methods", hide_short_help = true)]
    pub(in crate::cli) guide: Option<GuideSpec>,
    /// Depth head of --guide depth-anything, as for `complete` [default: learned].
    #[arg(long, value_parser = head(), requires = "guide", value_name = "HEAD", help_heading = "Methods", hide_short_help = true)]
    pub(in crate::cli) head: Option<ResizeLayer>,
    /// Also evaluate the standard deviations of `lsdc`: how many errors they cover, and how well they
    /// rank the errors.
    #[arg(long, help_heading = "Methods", hide_short_help = true)]
    pub(in crate::cli) uncertainty: bool,
    /// With --uncertainty: rates of phantom and missed obstacles also of the pixels whose standard deviation is at most this
    /// share of the predicted depth [default: 0.1].
    #[arg(
        long,
        value_name = "SHARE",
        requires = "uncertainty",
        help_heading = "Methods",
        hide_short_help = true
    )]
    pub(in crate::cli) sigma_cut: Option<f64>,
    /// Also score the depth maps of another program: FRAME.npy in metres or FRAME.png in millimetres,
    /// named like the frames of `lsdc export`; may be repeated.
    #[arg(long, value_parser = named_folder, value_name = "[NAME=]DIR", help_heading = "Methods", hide_short_help = true)]
    pub(in crate::cli) predictions: Vec<(String, PathBuf)>,
    /// Evaluate only part I of N of the frames (I starts at 0); `lsdc report merge` merges the parts.
    #[arg(long, value_parser = typed::<Shard>, default_value = "0/1", value_name = "I/N", help_heading = "Several machines", hide_short_help = true)]
    pub(in crate::cli) shard: Shard,
    /// Folder for the report in all formats, and for a journal, from which a restarted evaluation resumes.
    /// A part of --shard writes to DIR/I-of-N.
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Replace existing files, and start again in a folder that holds another evaluation.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) force: bool,
    /// Write the complete report to this file, as JSON.
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) json: Option<PathBuf>,
    /// Write the scores of each frame to this file, as CSV.
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) csv: Option<PathBuf>,
    /// Write an HTML page with charts and images to this file.
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) html: Option<PathBuf>,
    /// Write every prediction to this folder, as METHOD/seedN/FRAME.npy.
    #[arg(
        long,
        value_name = "DIR",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) save: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}

impl Eval {
    /// The output folder: each part of a sharded evaluation uses its own subfolder, so that all parts can be
    /// given the same folder.
    pub(in crate::cli) fn folder(&self) -> Option<PathBuf> {
        let folder = self.output.clone()?;
        Some(match self.shard {
            Shard::WHOLE => folder,
            part => folder.join(part.to_string()),
        })
    }

    /// Overrides the configuration with the flags.
    pub(in crate::cli) fn apply(&self, eval: &mut EvalConfig) {
        self.draws.apply(eval);
        eval.points = self.points.clone().or(eval.points.take());
        eval.hold_out = self.hold_out.or(eval.hold_out);
        eval.noise = self.noise.or(eval.noise);
        eval.sigma_cut = self.sigma_cut.unwrap_or(eval.sigma_cut);
        if !self.method.is_empty() {
            eval.methods.clone_from(&self.method);
        }
    }
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Export {
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    /// Split of the dataset.
    #[arg(long, value_parser = split(), default_value = "val")]
    pub(in crate::cli) split: Split,
    /// Published protocol, as for `eval` [default: that of the dataset].
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) protocol: Option<String>,
    /// Write only this frame, counted from 0 [default: all].
    #[arg(long, conflicts_with = "limit")]
    pub(in crate::cli) index: Option<usize>,
    /// Write only the first N frames.
    #[arg(long, value_name = "N")]
    pub(in crate::cli) limit: Option<usize>,
    /// Sparse points, as for `eval` [default: as in the protocol].
    #[arg(long, value_parser = typed::<Pattern>, value_name = "POINTS")]
    pub(in crate::cli) points: Option<Pattern>,
    /// Hold out part of each frame, as for `eval`: gt/FRAME.npy has what is scored.
    #[arg(long, value_parser = typed::<HoldOut>, value_name = "LAW")]
    pub(in crate::cli) hold_out: Option<HoldOut>,
    /// Corrupt the points, as for `eval`.
    #[arg(long, value_parser = typed::<Noise>, value_name = "NOISE")]
    pub(in crate::cli) noise: Option<Noise>,
    /// Seed of the random draw of points.
    #[arg(long, default_value_t = 0)]
    pub(in crate::cli) seed: u64,
    /// Folder for rgb/FRAME.png, sparse/FRAME.npy and gt/FRAME.npy.
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}
