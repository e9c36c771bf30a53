//! The bytes of an answer.

use crate::complete::CompletionResult;
use crate::fault::Fault;
use crate::frame::InputFrame;
use crate::layers;
use crate::media_type::MediaType;
use crate::options::Options;
use crate::report::JsonReport;
use lsdc_files::{
    ColoredCloud, DescribedCloud, DescribedPng, encode_depth_png, encode_exr, encode_npz,
    encode_ply,
};

/// An answer: its media type and bytes, and the report that goes with them.
pub(crate) struct EncodedAnswer {
    pub(crate) media_type: MediaType,
    pub(crate) bytes: Vec<u8>,
    pub(crate) report: JsonReport,
}

/// Encodes the answer.
///
/// # Errors
/// Depths that do not fit; a cloud without a camera.
pub(crate) fn encode(
    media_type: MediaType,
    found: &CompletionResult,
    frame: &InputFrame,
    options: &Options,
) -> Result<EncodedAnswer, Fault> {
    let mut report = JsonReport::new(found);
    let deviations = found.deviations.as_ref();
    let bytes = match media_type {
        MediaType::Json => (report.line() + "\n").into_bytes(),
        MediaType::Layers => layers::encode(found, &report),
        MediaType::Png => {
            let depth = found.depth()?;
            let png = DescribedPng::new(depth)?;
            report.png = Some(png);
            encode_depth_png(depth, png.unit.metres())?
        }
        MediaType::Exr => encode_exr(found.depth()?, deviations)?,
        MediaType::Npz => {
            let mut maps = vec![("depth", found.depth()?)];
            maps.extend(deviations.map(|map| ("sigma", map)));
            encode_npz(&maps)?
        }
        MediaType::Ply => {
            let camera = frame.camera.as_ref().ok_or_else(no_camera)?;
            let options = options.cloud();
            let cloud = ColoredCloud::new(found.depth()?, deviations, &frame.rgb, camera, &options);
            report.cloud = Some(DescribedCloud::from(&cloud));
            encode_ply(&cloud.points)?
        }
    };
    Ok(EncodedAnswer {
        media_type,
        bytes,
        report,
    })
}

/// The fault of a cloud without a camera.
pub(crate) fn no_camera() -> Fault {
    Fault::unusable("a cloud needs a camera")
        .hint("send the part `camera`: a file, or the text FX,FY,CX,CY")
}
