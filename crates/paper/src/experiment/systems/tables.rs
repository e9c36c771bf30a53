//! The tables of the page, including published rows.

use super::Systems;
use super::compared::OURS;
use super::condition::Condition;
use super::conditions::{ConditionGroup, Conditions};
use super::timing::{SIZE, TimedSystem};
use crate::experiment::tables::{column, of_methods, row};
use crate::experiment::{published, resolution};
use burn::tensor::Device;
use lsdc_eval::metrics::{Metric, Scores};
use lsdc_eval::report::{Column, Ranking, Row, Table};
use lsdc_eval::sampling::Size;
use lsdc_files::error::Result;
use lsdc_train::model::{InitNetwork as _, parameter_count};

const METRICS: [Metric; 5] = [
    Metric::Rmse,
    Metric::Rel,
    Metric::Delta1,
    Metric::Mae,
    Metric::See,
];

/// Returns a table with a row for each method.
fn methods(
    title: String,
    means: &[(String, Scores)],
    metrics: &[Metric],
    published: impl Iterator<Item = Row>,
) -> Table {
    let measured = means.iter();
    let measured = measured.map(|(name, scores)| Row::of(name, scores, metrics));
    of_methods(title, metrics, measured.chain(published).collect())
}

/// Returns the errors with the points of the training.
pub(super) fn as_trained(points: &impl ToString, means: &[(String, Scores)]) -> Table {
    let systems = published::SYSTEMS.iter().flat_map(|system| system.rows);
    let published = systems.map(|(label, (rmse, rel, delta))| {
        published::row(label, vec![Some(*rmse), Some(*rel), *delta, None, None])
    });
    let title = format!("Errors, {}", points.to_string());
    methods(title, means, &METRICS, published)
}

/// Returns the errors of depth at three times the resolution of the image.
pub(super) fn sharp(condition: &Condition<'_>) -> Result<Table> {
    use resolution::{LARGE, METRICS, POINTS, SMALL};
    let published = published::TABLE_3
        .iter()
        .map(|(name, [rmse, rel])| published::row(name, vec![Some(*rmse), Some(*rel), None, None]));
    let title = format!("Image and {POINTS} points at {SMALL}, depth at {LARGE}");
    Ok(methods(title, &condition.means()?, &METRICS, published))
}

/// Returns a metric of all methods under the conditions of a group and that of the training, with a column for each method.
pub(super) fn compared<'a>(
    conditions: &Conditions<'a>,
    group: &ConditionGroup<'a>,
    metric: Metric,
) -> Result<Table> {
    let mut names = Vec::new();
    let mut rows = Vec::new();
    for condition in std::iter::once(&conditions.trained).chain(&group.conditions) {
        let means = condition.means()?;
        names = means.iter().map(|(name, _)| name.clone()).collect();
        let values: Vec<_> = means.iter().map(|(_, s)| Some(s[metric])).collect();
        rows.push(row(&condition.label, values));
    }
    Ok(Table {
        title: format!("{}: {}", group.title, metric.label()),
        row_header: group.row_header.to_owned(),
        ranking: Ranking::Columns,
        columns: names.iter().map(|n| Column::named(n, metric)).collect(),
        rows,
    })
}

/// Returns parameters, and times of a frame.
pub(super) fn cost(systems: &Systems<'_>) -> Result<Table> {
    let measured = systems.timings.iter();
    let mut rows = measured
        .map(|timing| cost_of(systems, timing))
        .collect::<Result<Vec<_>>>()?;
    for (name, parameters, total) in published::TABLE_5 {
        let values = vec![None, Some(parameters), None, Some(total)];
        rows.push(published::row(name, values));
    }
    let Size { height, width } = SIZE;
    Ok(Table {
        title: format!("Cost of a frame of {width}x{height}"),
        row_header: "method".into(),
        ranking: Ranking::None,
        columns: vec![
            column("parameters", "M", 3),
            column("as counted", "M", 3),
            column("weights", "MB", 1),
            column("total", "ms", 1),
        ],
        rows,
    })
}

fn cost_of(systems: &Systems<'_>, timing: &TimedSystem<'_>) -> Result<Row> {
    let device = Device::flex();
    let (label, parameters, never_run) = match timing.system() {
        None => {
            let net = systems.compared.context.network.init(0, &device)?;
            (OURS, parameter_count(&net), 0)
        }
        Some(system) => {
            let config = system.config();
            let count = parameter_count(&config.blank(&device)?);
            (system.name(), count, config.never_run())
        }
    };
    let millions = |parameters: usize| parameters as f64 / 1e6;
    let values = [
        Some(millions(parameters)),
        Some(millions(parameters + never_run)),
        // Four bytes per parameter.
        Some(parameters as f64 * 4.0 / 1e6),
        timing.total()?,
    ];
    Ok(row(label, values))
}
