//! Depth at three times the resolution of the image (Fang et al., section 4.5, table 3).

use super::benchmark::BASELINES;
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study, published, tables};
use lsdc_eval::evaluation::{Candidate, Enlargement};
use lsdc_eval::metrics::Metric;
use lsdc_eval::predict::Method;
use lsdc_eval::report::{Row, Section};
use lsdc_eval::sampling::{Interpolation, Pattern, Protocol, Size};
use lsdc_files::error::Result;

pub(super) const SMALL: Size = Size {
    height: 120,
    width: 160,
};
pub(super) const LARGE: Size = Size {
    height: 360,
    width: 480,
};
/// Size inside the white border of the images of NYU Depth v2.
const INSIDE: Size = Size {
    height: 456,
    width: 608,
};
pub(super) const POINTS: usize = 500;
pub(super) const METRICS: [Metric; 4] = [Metric::Rmse, Metric::Rel, Metric::See, Metric::Delta1];

pub(super) struct Resolution<'a> {
    context: &'a ExperimentContext,
    small: Measured<'a>,
    plain: Measured<'a>,
}

impl<'a> Resolution<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let protocol = protocol(context);
        let trial = |name: &str| {
            Measured::new(context, name)
                .resized(protocol, "of the experiment")
                .points(Pattern::Exactly(POINTS))
        };
        let mut methods = vec![
            enlarged("lsdc".into(), Method::Lsdc, Enlargement::Bases),
            enlarged("lsdc, bilinear".into(), Method::Lsdc, Enlargement::Bilinear),
        ];
        for method in BASELINES {
            let name = format!("{}, bilinear", method.name());
            methods.push(enlarged(name, method, Enlargement::Bilinear));
        }
        methods.push(("lsdc, large image".into(), Candidate::Method(Method::Lsdc)));
        let plain = |name: &str, by| enlarged(name.into(), Method::Lsdc, by);
        Self {
            context,
            small: trial("resolution").candidates(methods),
            plain: trial("resolution-plain")
                .candidates(vec![
                    plain("lsdc, the paper's fit", Enlargement::Bases),
                    plain("lsdc, the paper's fit, bilinear", Enlargement::Bilinear),
                ])
                .paper_fit(),
        }
    }
}

/// Returns the protocol of frames at the higher resolution.
pub(super) fn protocol(context: &ExperimentContext) -> Protocol {
    Protocol {
        cut: context.preset.name.starts_with("nyu").then_some(INSIDE),
        resize: Some(LARGE),
        crop: None,
        // Interpolation between two surfaces would blur edges.
        depth_resize: Interpolation::PilNearest,
        ..context.preset.protocol
    }
}

/// Returns a method that completes at the lower resolution.
pub(super) fn enlarged(name: String, method: Method, by: Enlargement) -> (String, Candidate) {
    let from = SMALL;
    (name, Candidate::Enlarged { method, from, by })
}

impl Study for Resolution<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        vec![&self.small, &self.plain]
    }

    fn section(&self) -> Result<Section> {
        let title = "Depth at three times the resolution of the image (table 3)";
        let mut section = Section::new("resolution", title);
        section.about.push(format!(
            "{} Image and {POINTS} points at {SMALL}, depth at {LARGE}: basis functions read there, or \
             depths enlarged bilinearly. Averaged {}.",
            self.context.about(),
            self.context.rules
        ));
        section.about.push(
            "\"Large image\" is what users have who see more than 120x160 pixels: the image at \
             360x480; it does not compete."
                .into(),
        );
        let mut rows: Vec<Row> = Vec::new();
        for (name, scores) in self.small.means()?.iter().chain(&self.plain.means()?) {
            rows.push(Row::of(name, scores, &METRICS));
        }
        let mut table = tables::of_methods("Errors at 360x480", &METRICS, rows);
        let unranked_row = table
            .rows
            .iter()
            .position(|row| row.label == "lsdc, large image");
        let unranked_row = unranked_row.map(|at| table.rows.remove(at));
        section.findings.extend(table.ranking_summary("lsdc"));
        table.rows.extend(unranked_row.map(|row| Row {
            unranked: true,
            ..row
        }));
        for (name, [rmse, rel]) in published::TABLE_3 {
            let values = vec![Some(rmse), Some(rel), None, None];
            table.rows.push(published::row(name, values));
        }
        section.tables.push(table);
        section.notes = published::notes(&published::TABLE_3_NOTES);
        let caption = "The frame on which lsdc is neither good nor bad.";
        self.small.show(&mut section, caption)?;
        Ok(section)
    }
}
