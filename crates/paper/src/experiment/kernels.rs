//! Pictures of basis functions, and of the pixels that they make similar.

use super::trial::Trial;
use super::{ExperimentContext, Study};
use lsdc_eval::report::{Panels, Section, contact_sheet, diverging_scale, kernels};
use lsdc_files::error::Result;

/// Number of frames shown.
const FRAMES: usize = 3;

pub(super) struct KernelsStudy<'a> {
    context: &'a ExperimentContext,
}

impl<'a> KernelsStudy<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        Self { context }
    }
}

impl Study for KernelsStudy<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        Vec::new()
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("kernels", "Basis functions, and what they take for alike");
        section.about.push(format!(
            "{}. The kernel of a pixel is the cosine of the angle between its base vector and those \
             of all pixels, less the mean over the image: a fit moves pixels of a high value together.",
            self.context.weights
        ));
        let frames = self.context.frames.len();
        let shown = FRAMES.min(frames);
        let mut rows = Vec::new();
        for number in 0..shown {
            let index = number * frames / shown;
            let frame = self.context.frames.load(index)?;
            let rgb = self.context.preset.protocol.apply(&frame)?.rgb;
            if number == 0 {
                section.add_figure(
                    "functions",
                    "The basis functions that change most over the first frame.",
                    contact_sheet(&self.context.completer, &rgb)?,
                );
            }
            rows.push(kernels(&self.context.completer, rgb)?);
        }
        let panels = Panels {
            title: "Kernels of pixels".into(),
            scales: vec![diverging_scale("cosine", 1.0)],
            rows,
        };
        section.add_figure("kernels", "Crosses mark the pixels.", panels.draw());
        Ok(section)
    }
}
