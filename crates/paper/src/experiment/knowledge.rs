//! The value of trained weights: errors of several weights for few and many points.

use super::cost::{POINTS, SIZES, Timed, TimedSubject};
use super::tables::{column, line, row, show_by_count};
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study};
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{Column, Line, Ranking, Section, Table};
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::Result;
use lsdc_train::predict::open_completer;
use lsdc_weights::{open_weights, weights_name};
use std::path::Path;

const COUNTS: [usize; 9] = [1, 5, 20, 50, 100, 200, 500, 1000, 5000];
/// Weights in the order of increasing prior knowledge.
const WEIGHTS: [&str; 4] = ["none", "small", "default", "anything"];
/// Weights that are also evaluated with guides, if there are any.
const GUIDED: [&str; 2] = ["none", "default"];

/// Weights with their measurements.
struct ComparedWeights<'a> {
    name: String,
    /// Number of parameters in millions, without a pretrained encoder.
    parameters: f64,
    errors: Vec<Measured<'a>>,
    times: Vec<Timed<'a>>,
}

pub(super) struct Knowledge<'a> {
    context: &'a ExperimentContext,
    compared: Vec<ComparedWeights<'a>>,
    /// Messages about weights that cannot be opened.
    missing: Vec<String>,
}

impl<'a> Knowledge<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let (mut compared, mut missing) = (Vec::new(), Vec::new());
        let guided = GUIDED.into_iter().filter(|_| context.guides.is_some());
        let all = WEIGHTS.into_iter().map(|name| (name, false));
        for (name, guided) in all.chain(guided.map(|name| (name, true))) {
            match ComparedWeights::new(context, name, guided) {
                Ok(weights) => compared.push(weights),
                Err(error) => missing.push(format!("`{name}` is left out: {error}.")),
            }
        }
        Self {
            context,
            compared,
            missing,
        }
    }

    fn errors(&self, metric: Metric) -> Result<(Table, Vec<Line>)> {
        let mut rows = COUNTS.map(|count| row(count.to_string(), Vec::new()));
        let mut lines = Vec::new();
        for (colour, weights) in self.compared.iter().enumerate() {
            let mut points = Vec::new();
            for ((count, row), trial) in COUNTS.iter().zip(&mut rows).zip(&weights.errors) {
                let value = trial.first_scores()?[metric];
                row.values.push(Some(value));
                points.push((*count as f64, value));
            }
            lines.push(line(&weights.name, colour, points));
        }
        let names = self.compared.iter();
        let table = Table {
            title: metric.label().to_owned(),
            row_header: "points".to_owned(),
            ranking: Ranking::Columns,
            columns: names.map(|c| Column::named(&c.name, metric)).collect(),
            rows: rows.into(),
        };
        Ok((table, lines))
    }

    fn costs(&self) -> Result<Table> {
        let mut rows = Vec::new();
        for weights in self.compared.iter().filter(|c| !c.times.is_empty()) {
            let mut values = vec![Some(weights.parameters)];
            for timed in &weights.times {
                values.push(Some(timed.total()?));
            }
            rows.push(row(&weights.name, values));
        }
        let times = SIZES.map(|size| column(format!("{}x{}", size.width, size.height), "ms", 0));
        let parameters = column("parameters", "M", 2);
        Ok(Table {
            title: format!("Size, and time from an image to depth with {POINTS} points"),
            row_header: "weights".to_owned(),
            ranking: Ranking::None,
            columns: std::iter::once(parameters).chain(times).collect(),
            rows,
        })
    }
}

impl<'a> ComparedWeights<'a> {
    fn new(context: &'a ExperimentContext, weights: &str, guided: bool) -> Result<Self> {
        let path = Some(Path::new(weights));
        let completer = open_completer(path, &context.device.0)?;
        let label = weights_name(path)?;
        let parameters = if weights == "none" {
            0
        } else {
            open_weights(path)?.parameters()
        };
        let name = if guided {
            format!("{weights} + guide")
        } else {
            weights.to_owned()
        };
        let stem = format!("knowledge-{}", name.replace(" + ", "-"));
        let guides = context.guides.clone().filter(|_| guided);
        let error = |count: usize| {
            Measured::new(context, format!("{stem}-{count}"))
                .completer(completer.clone(), label.clone())
                .guides(guides.clone())
                .points(Pattern::Exactly(count))
        };
        let time = |size: lsdc_eval::sampling::Size| Timed {
            context,
            name: format!("{stem}-{}", size.width),
            label: label.clone(),
            subject: TimedSubject::Other(Box::new(completer.clone())),
            size,
        };
        Ok(Self {
            parameters: parameters as f64 / 1e6,
            errors: COUNTS.map(error).into(),
            // The guide is read from a file, so the time to compute it is unknown.
            times: if guided {
                Vec::new()
            } else {
                SIZES.map(time).into()
            },
            name,
        })
    }
}

impl Study for Knowledge<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        let mut trials: Vec<&dyn Trial> = Vec::new();
        for weights in &self.compared {
            trials.extend(weights.errors.iter().map(|trial| trial as &dyn Trial));
            trials.extend(weights.times.iter().map(|trial| trial as &dyn Trial));
        }
        trials
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("knowledge", "What the knowledge of a network is worth");
        section.about.push(self.context.about());
        section.about.push(
            "The weights that there are, each with its own fit. `none` has no network: a field along the colours of \
             the image."
                .into(),
        );
        for metric in [Metric::Rmse, Metric::Rel] {
            let (table, lines) = self.errors(metric)?;
            section.tables.push(table);
            let caption = format!("{} against the number of points.", metric.label());
            show_by_count(&mut section, metric.key(), &caption, metric, lines);
        }
        section.tables.push(self.costs()?);
        section.notes.extend(self.missing.iter().cloned());
        Ok(section)
    }
}
