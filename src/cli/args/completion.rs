//! Arguments of `complete` and `bench`.

use super::values::{
    Format, PoseSource, deviation, edge, head, noise, preserve, range, share, size, typed,
};
use super::{FitFlags, Model, Recorded, Settings};
use clap::Args as ClapArgs;
use lsdc_core::DepthNoise;
use lsdc_eval::data::{Camera, DepthKind, Shard, Unit};
use lsdc_eval::predict::{GuideSpec, Method, Preserve};
use lsdc_eval::sampling::Size;
use lsdc_files::WorkspaceFormat;
use lsdc_weights::ResizeLayer;
use std::path::PathBuf;

#[derive(Clone, Debug, ClapArgs)]
#[command(
    // A single input is a recording, in the place of the points.
    allow_missing_positional = true,
    after_help = "`lsdc complete --help` shows every option.",
    after_long_help = "See docs/guide.md for example commands for every kind of data."
)]
pub(in crate::cli) struct Complete {
    /// Colour image, or several: files, a folder, a pattern or a list; none with a recording.
    ///
    /// JPEG, PNG, WebP, TIFF, BMP or PNM. A pattern is quoted, as in 'left/*.png'. A list (txt) has one image per line,
    /// optionally followed by its points file (else the points are taken from the folder of points); quote names with
    /// spaces. `-` is standard input.
    pub(in crate::cli) rgb: Vec<PathBuf>,
    /// Sparse depths: a depth map, a table of points, a point cloud, a COLMAP model, or for several images a folder of
    /// such files; or a recording of ROS 2 without an image.
    ///
    /// A depth map of the image's shape (npy, npz, 16-bit PNG, PGM, TIFF, EXR, PFM, HDF5); a
    /// table of points (csv, txt, npy of shape (points, 3 or 4)) with columns u, v, depth[, sigma], where u
    /// and v are pixels counted from 0 at the centre of the first, or with --camera x, y, z, as named by a
    /// header line `u,v,depth` or `x,y,z` (without a header, a table holds x, y, z if --camera is given and
    /// most of its rows cannot be pixels; ambiguous tables are rejected); a point cloud (PLY, PCD, LAS, LAZ,
    /// xyz, KITTI's bin; needs --camera); or a COLMAP sparse model. 0, NaN, infinite and negative values
    /// mean no measurement. For several images: a folder of such files with matching names, or a model.
    /// `-` is standard input. Or, without an image, a recording of ROS 2: an MCAP file, a db3 file of rosbag2, or the
    /// folder of a bag, of which --image and --points name topics.
    #[arg(required = true)]
    pub(in crate::cli) sparse: PathBuf,
    /// Folder for the results, or for a single image a file [default: the folder of the image].
    ///
    /// The extension of a file selects the format; `-` is standard output. For a recording, also an mcap file.
    #[arg(short, long, value_name = "PATH", help_heading = "Output")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Unit of the sparse depths: m, cm, mm, kitti, tum, vkitti or a number [default: mm for integers, else m].
    ///
    /// kitti is 1/256 m, tum 1/5000 m, vkitti 1/100 m; a number counts the units per metre. Without this option, depths
    /// from COLMAP stay in the unit of the model.
    #[arg(long, value_parser = typed::<Unit>, value_name = "UNIT", help_heading = "Input")]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Kind of the depths of maps and of tables of pixels: z or ray [default: z].
    ///
    /// z is depth along the optical axis; ray is the distance from the optical centre along the ray of the pixel, as of
    /// Hypersim, and needs --camera.
    #[arg(
        long,
        value_parser = typed::<DepthKind>,
        value_name = "KIND",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) depth_kind: Option<DepthKind>,
    /// Camera for point clouds: a file, or FX,FY,CX,CY in pixels.
    ///
    /// It projects point clouds and back-projects pixels. A file is TOML or JSON with fx, fy, cx, cy, distortion and
    /// pose, or a ROS calibration in YAML. If EXIF rotates the image, intrinsics refer to the pixels as stored, unless
    /// their size matches only the upright image.
    #[arg(long, value_parser = typed::<Camera>, value_name = "CAMERA", help_heading = "Input")]
    pub(in crate::cli) camera: Option<Camera>,
    /// Output formats: npy, npz, png, color, tiff, exr, pfm, ply, json [default: npy,png,color].
    ///
    /// npy (float32, metres), png (16 bits, millimetres or, if the depths do not fit, a unit recorded in the file), color
    /// (a colour map with its scale), tiff, exr, pfm (metres), npz (metres; exr and npz include the standard deviations
    /// of --uncertainty), ply (a coloured point cloud; needs a camera), json (a report).
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_delimiter = ',',
        value_name = "FORMAT,...",
        help_heading = "Output"
    )]
    pub(in crate::cli) formats: Option<Vec<Format>>,
    /// Workspaces to write for other programs: colmap, splatting, nerfstudio; needs a COLMAP model.
    ///
    /// A workspace is the folder of this name in the folder of results, with images, cameras and a depth map for each image,
    /// in the unit of the model. colmap: depth and normal maps for `colmap stereo_fusion` and the meshers. splatting: inverse
    /// depths for `train.py -d depths` of 3-D Gaussian splatting. nerfstudio: `transforms.json`, for depth-nerfacto. Without
    /// --formats, no other depth maps are written. See docs/colmap.md.
    #[arg(
        long,
        value_parser = typed::<WorkspaceFormat>,
        value_delimiter = ',',
        value_name = "PROGRAM,...",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) export: Vec<WorkspaceFormat>,
    /// Leave pixels empty whose standard deviation is larger than this share of their depth: 0 in depth maps, no point in clouds,
    /// empty in the workspaces of --export. The summary and the report count them.
    ///
    /// By default depth maps and workspaces for splatting are full, and clouds and other workspaces have no pixels above 0.1,
    /// which count as not measured.
    #[arg(long, value_parser = share, value_name = "SHARE", help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) max_relative_sigma: Option<f32>,
    /// Depths in metres of the first and the last colour of the colour map [default: the range of the middle 98 % of
    /// the pixels].
    #[arg(long, value_parser = range, value_name = "LOW,HIGH", help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) range: Option<(f32, f32)>,
    /// Leave pixels empty whose standard deviation is larger, in metres: 0 in depth maps, no point in clouds. The summary
    /// and the report count them.
    #[arg(long, value_parser = deviation, value_name = "METRES", help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) max_sigma: Option<f32>,
    /// Keep one point in each cube of this edge length of a point cloud, in metres: the mean of its pixels.
    #[arg(long, value_parser = edge, allow_negative_numbers = true, value_name = "METRES", help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) voxel: Option<f64>,
    /// Keep the flying pixels of point clouds: those between the surfaces at a depth edge, which are left out
    /// otherwise, and counted.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) keep_flying: bool,
    /// Size of the result, as WIDTHxHEIGHT [default: the size of the image].
    #[arg(long, value_parser = size, help_heading = "Output")]
    pub(in crate::cli) size: Option<Size>,
    /// Completion method: lsdc, nearest, linear, linear-inverse, idw, tps, wls, levin, steering, ip-basic (`lsdc eval --help`
    /// names the publications).
    #[cfg_attr(
        feature = "train",
        doc = "With weights of their own, given by --weights: s2d, cspn, lsk."
    )]
    #[arg(long, value_parser = typed::<Method>, default_value = "lsdc", value_name = "NAME", help_heading = "Fit", hide_short_help = true)]
    pub(in crate::cli) method: Method,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// How to preserve the input depths: none (the result may differ from them), exact (write them at
    /// their pixels), blend (also adjust the neighbourhood to join smoothly).
    #[arg(
        long,
        value_parser = preserve(),
        default_value = "none",
        value_name = "HOW",
        help_heading = "Fit",
        hide_short_help = true
    )]
    pub(in crate::cli) preserve_input: Preserve,
    /// The standard deviation of each sparse depth, as a map in the unit of the depths [default: the sigma
    /// column of a table]. It is absolute: how far the measurement may be off the true depth there. The less
    /// precise points are, compared with how depth varies between them, the smoother the result, and the larger
    /// its own standard deviations. For points without one, the noise of the fit is assumed.
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) sigma: Option<PathBuf>,
    /// Noise of a depth camera: kinect, realsense, tof, or A,B,C [default: none].
    ///
    /// The standard deviation of a depth of z metres is A + B z + C z^2 metres; it is used for all points that have none.
    /// kinect: Kinect v1 and others of `PrimeSense`, 0.0015 - 0.0015 z + 0.0019 z^2 (Nguyen et al. 2012). realsense: D435,
    /// 0.0036 z^2 (Intel). tof: Kinect v2 and other time-of-flight cameras, 0.0015 - 0.0005 z + 0.0003 z^2
    /// (Fankhauser et al. 2015). Needs --depth-unit for depths in integers, whose unit would be a guess.
    #[arg(long, value_parser = noise, value_name = "MODEL", help_heading = "Input", allow_hyphen_values = true)]
    pub(in crate::cli) noise: Option<DepthNoise>,
    /// Dense depth prediction to use as a guide: FILE[:KIND], depth-anything[:SIDE] or none.
    ///
    /// A prediction by another network or program, which need not be of the image's size: npy, npz, PNG, TIFF, EXR, PFM
    /// or HDF5. KIND: depth, disparity or log [default: depth]. Disparity is inverse depth, as in `map.npy:disparity`.
    /// The fit finds its scale and shift, and from the points how far to trust it. For several images: a folder of such
    /// files with matching names. It shows the upright image. With --weights none, depth is completed from the guide
    /// without a network.
    ///
    /// depth-anything predicts the guide with Depth Anything V2 Small, which `lsdc weights get anything` or `lsdc
    /// weights add` installs. SIDE is the shorter side of the image that it reads, 252 to 518 pixels [default: 336]. A
    /// file of this name is ./depth-anything.
    ///
    /// The weights `anything` have a guide by default: that of the depth head installed with their encoder, which runs once
    /// for both, on the image that the network reads. none switches it off.
    #[arg(long, value_parser = typed::<GuideSpec>, value_name = "GUIDE", help_heading = "Input")]
    pub(in crate::cli) guide: Option<GuideSpec>,
    /// Depth head of --guide depth-anything: learned or published [default: learned].
    ///
    /// They differ in one tensor. Accuracy and standard deviations were measured with the learned one, which comes with
    /// lsdc. The published one is read from the installed file, which may lack it.
    #[arg(
        long,
        value_parser = head(),
        requires = "guide",
        value_name = "HEAD",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) head: Option<ResizeLayer>,
    /// Also write the standard deviation of every pixel of the result, in metres.
    ///
    /// It is half the width of the interval that holds 68.3 % of errors. The summary has the number of standard deviations
    /// that hold 95 %.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) uncertainty: bool,
    /// Also write a list of the points that disagree with the others.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) outliers: bool,
    /// Do not check whether the points lie where the images show them. The check is made in the first five of several
    /// images, and warns of a shift, as wrong extrinsics or time stamps cause.
    #[arg(long, help_heading = "Fit", hide_short_help = true)]
    pub(in crate::cli) no_alignment: bool,
    /// Run the network on the image at full resolution, instead of resizing it to the number of pixels of
    /// the training images. Rarely more accurate, and slower by far.
    #[arg(long, help_heading = "Network", hide_short_help = true)]
    pub(in crate::cli) full: bool,
    /// Treat the images as a video: the weights of the basis functions are pulled towards those of the
    /// previous frame, which reduces flicker with few points. The weights of each frame are kept in the folder .lsdc of
    /// the results, for a run that resumes.
    #[arg(long, help_heading = "Several frames", hide_short_help = true)]
    pub(in crate::cli) temporal: bool,
    /// Join the measured points of neighbouring images, carried over by their poses.
    ///
    /// Poses are those of the COLMAP model, of the recording by its transforms, or of POSES: a TUM trajectory, KITTI rows, a folder of 4x4 matrices, or a
    /// transforms.json, which needs no --camera if it has intrinsics. Carried points are checked against the points of
    /// the image: occluded ones are left out, and so are images whose poses contradict them; the summary counts both.
    #[arg(
        long,
        value_name = "POSES",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "",
        help_heading = "Several frames"
    )]
    pub(in crate::cli) views: Option<PoseSource>,
    /// With --views, only earlier images are neighbours, as online: in the order of their names, or of time in a recording.
    #[arg(
        long,
        requires = "views",
        help_heading = "Several frames",
        hide_short_help = true
    )]
    pub(in crate::cli) views_past: bool,
    /// With --views, the most neighbours of an image, up to 20 [default: 8].
    #[arg(long, requires = "views", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=20), help_heading = "Several frames", hide_short_help = true)]
    pub(in crate::cli) views_count: Option<u32>,
    /// Complete only part I of N of the images (I starts at 0).
    #[arg(long, value_parser = typed::<Shard>, default_value = "0/1", value_name = "I/N", help_heading = "Several frames", hide_short_help = true)]
    pub(in crate::cli) shard: Shard,
    /// Replace existing results.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) force: bool,
    /// Print one JSON object per frame.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) recorded: Recorded,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}

impl Complete {
    /// An option that was given and is for clouds alone.
    pub(in crate::cli) fn of_clouds(&self) -> Option<&'static str> {
        let options = [
            ("--voxel", self.voxel.is_some()),
            ("--keep-flying", self.keep_flying),
        ];
        let mut given = options.into_iter().filter(|(_, given)| *given);
        given.next().map(|(name, _)| name)
    }
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Bench {
    #[cfg_attr(
        feature = "train",
        doc = "Size of image and result, as WIDTHxHEIGHT [default: 640x480; with --training 304x228]."
    )]
    #[cfg_attr(
        not(feature = "train"),
        doc = "Size of image and result, as WIDTHxHEIGHT [default: 640x480]."
    )]
    #[arg(long, value_parser = size)]
    pub(in crate::cli) size: Option<Size>,
    /// Number of sparse points.
    #[arg(long, default_value_t = 500)]
    pub(in crate::cli) points: usize,
    /// Number of completions or training steps to time, after one warm-up.
    #[arg(long, default_value_t = 15)]
    pub(in crate::cli) runs: usize,
    /// Method: lsdc, or one without training.
    #[cfg_attr(
        feature = "train",
        doc = "With weights of their own, given by --weights: s2d, cspn, lsk."
    )]
    #[arg(long, value_parser = typed::<Method>, default_value = "lsdc", value_name = "NAME")]
    pub(in crate::cli) method: Method,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// Run the network on the image at full resolution, instead of resizing it to the number of pixels of
    /// the training images.
    #[arg(long)]
    pub(in crate::cli) full: bool,
    /// Also time the prediction of guides, beside the completion: depth-anything[:SIDE], or several of them. none: without
    /// the guide that the weights `anything` have by default.
    #[arg(long, value_parser = typed::<GuideSpec>, value_delimiter = ',', value_name = "GUIDE,...")]
    pub(in crate::cli) guide: Vec<GuideSpec>,
    /// Time training steps instead, on procedural rooms: those of --config, or of the network of the weights by the
    /// paper's settings (two images, every pixel in the loss). Batch normalisation has fixed statistics if most steps of
    /// the run would.
    #[arg(long, conflicts_with_all = ["full", "guide", "points"])]
    #[cfg_attr(not(feature = "train"), arg(hide = true))]
    pub(in crate::cli) training: bool,
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    /// Print one JSON object.
    #[arg(long)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}
