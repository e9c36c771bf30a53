//! The bytes of an answer.

use crate::complete::Completed;
use crate::fault::Fault;
use crate::forms::{Form, Forms, Png};
use crate::frame::Frame;
use crate::layers;
use crate::options::Options;
use crate::report::Report;
use lsdc_files::{
    Cloud, encode_depth_png, encode_exr, encode_npz, encode_ply, png_unit, raised_in_png,
};

/// An answer: its form and bytes, and the report that goes with them.
pub(crate) struct Encoded {
    pub(crate) form: Form,
    pub(crate) bytes: Vec<u8>,
    pub(crate) report: Report,
}

/// Makes the answer of a form.
///
/// # Errors
/// Depths that do not fit; a cloud without a camera.
pub(crate) fn encode(
    form: Form,
    found: &Completed,
    frame: &Frame,
    options: &Options,
) -> Result<Encoded, Fault> {
    let mut forms = Forms::default();
    let deviations = found.deviations.as_ref();
    let mut bytes = Vec::new();
    match form {
        Form::Json | Form::Layers => {}
        Form::Png => {
            let depth = found.depth()?;
            let unit = png_unit(depth)?;
            let raised = raised_in_png(depth, unit.metres());
            forms.png = Some(Png { unit, raised });
            bytes = encode_depth_png(depth, unit.metres())?;
        }
        Form::Exr => bytes = encode_exr(found.depth()?, deviations)?,
        Form::Npz => {
            let maps = [("depth", Some(found.depth()?)), ("sigma", deviations)];
            let maps = maps
                .into_iter()
                .filter_map(|(name, map)| Some((name, map?)));
            bytes = encode_npz(&maps.collect::<Vec<_>>())?;
        }
        Form::Ply => {
            let camera = frame.camera.as_ref().ok_or_else(no_camera)?;
            let options = options.cloud();
            let cloud = Cloud::new(found.depth()?, deviations, &frame.rgb, camera, &options);
            bytes = encode_ply(&cloud.points)?;
            forms.cloud = Some(cloud);
        }
    }
    let report = Report::new(found, &forms);
    match form {
        Form::Json => bytes = (report.line() + "\n").into_bytes(),
        Form::Layers => bytes = layers::encode(found, &report),
        _ => {}
    }
    Ok(Encoded {
        form,
        bytes,
        report,
    })
}

/// That a cloud cannot be made.
pub(crate) fn no_camera() -> Fault {
    Fault::unusable("a cloud needs a camera")
        .hint("send the part `camera`: a file, or the text FX,FY,CX,CY")
}
