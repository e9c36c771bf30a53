//! The page: its text, and the order of its tables and pictures.

use super::Systems;
use super::compared::{ComparedSystem, OURS, SAME_BUDGET};
use super::training::Budget;
use super::{pictures, tables};
use crate::experiment::published;
use crate::systems::SystemConfig;
use lsdc_eval::metrics::{Metric, Scores};
use lsdc_eval::report::Section;
use lsdc_files::error::Result;

pub(super) fn section(systems: &Systems<'_>) -> Result<Section> {
    let title = "The systems that the paper compares itself with, side by side";
    let mut section = Section::new("systems", title);
    section.about = about(systems);

    let (compared, conditions) = (&systems.compared, &systems.conditions);
    let means = conditions.trained.means()?;
    let table = tables::as_trained(&compared.context.preset.points, &means);
    section.add_ranked_table(table, OURS);
    let all = compared.systems.iter();
    section
        .findings
        .extend(all.filter_map(|system| surpassed(system, &means)));

    for &metric in conditions.counts.metrics {
        let table = tables::compared(conditions, &conditions.counts, metric)?;
        pictures::points(&mut section, &table, metric);
        section.add_ranked_table(table, OURS);
    }
    for group in &conditions.others {
        for &metric in group.metrics {
            section.add_ranked_table(tables::compared(conditions, group, metric)?, OURS);
        }
    }
    section.add_ranked_table(tables::sharp(&conditions.sharp)?, OURS);
    section.tables.push(tables::cost(systems)?);
    pictures::frames(&mut section, conditions)?;
    section.notes = published::notes(&published::SYSTEMS_NOTES);
    Ok(section)
}

/// Describes the training of each system, and the common settings.
fn about(systems: &Systems<'_>) -> Vec<String> {
    let context = systems.compared.context;
    let mut about = vec![format!("{} {}.", context.about(), context.preset.points)];
    for system in &systems.compared.systems {
        let here = match system {
            ComparedSystem::Given(..) => "",
            ComparedSystem::Trained(_) => "trained here, ",
        };
        let start = match system.config().pretrained() {
            Some(path) => format!("encoder from `{}`", path.display()),
            None => "from random weights".to_owned(),
        };
        about.push(format!(
            "{}: {}; {here}{}, {start}.",
            system.name(),
            system.config().kind().source(),
            system.training()
        ));
    }
    if systems.compared.same_budget.is_some() {
        about.push(format!(
            "{SAME_BUDGET}: the network of the recipe, trained from random weights for {} as well, with \
             the plain fit. `lsdc` itself has the weights named above, which were trained for longer.",
            Budget::of(&context.recipe.train)
        ));
    }
    about.push(
        "All see the same frames and the same points; predictions of all are kept within ten times the range of \
         the points. An image of another size is resized to that of the training."
            .into(),
    );
    about
}

/// States that a published result is better than the one measured here, and possible reasons.
fn surpassed(system: &ComparedSystem<'_>, means: &[(String, Scores)]) -> Option<String> {
    let published = system.published()?;
    let (name, scores) = means.iter().find(|(name, _)| name == system.name())?;
    let best = published.rows.iter().map(|(_, errors)| errors.0);
    let best = best.fold(f64::MAX, f64::min);
    let here = scores[Metric::Rmse];
    let start = match (system.config(), system.config().pretrained()) {
        (SystemConfig::Lsk(_), _) => "random weights",
        (_, Some(_)) => "an encoder trained on ImageNet",
        (_, None) => "random weights, where the authors start from an encoder trained on ImageNet",
    };
    (best < here).then(|| {
        format!(
            "{name}: published RMSE {best:.3} m, here {here:.3} m: {} from {start}; published: {}, on all 654 frames \
             of the official split",
            system.training(),
            published.training
        )
    })
}
