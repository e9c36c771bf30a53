//! Tables of errors by scene.

use super::{Column, EvaluationReport, FrameScores, Ranking, Row, Table};
use crate::metrics::Metric;
use std::collections::BTreeMap;

/// Limit of scenes in text and on the page; files have all of them.
const MOST: usize = 30;

/// Metrics of the tables.
const METRICS: [Metric; 3] = [Metric::Rmse, Metric::Mae, Metric::Rel];

impl EvaluationReport {
    /// Returns the scenes with their numbers of frames; empty if there is only one scene, if each has a single frame, or if the
    /// scene of a frame is unknown.
    pub fn scenes(&self) -> BTreeMap<&str, usize> {
        let mut scenes = BTreeMap::new();
        let mut last = None;
        for ((frame, _), scores) in &self.frames {
            let Some(scene) = scene(frame, scores) else {
                return BTreeMap::new();
            };
            let count = scenes.entry(scene).or_insert(0);
            // The seeds of a frame follow each other.
            *count += usize::from(last != Some(frame));
            last = Some(frame);
        }
        if scenes.len() < 2 || scenes.values().all(|count| *count == 1) {
            scenes.clear();
        }
        scenes
    }

    /// Returns each method's average over the frames of a scene.
    pub fn means_of_scene(&self, name: &str) -> Vec<super::Mean<'_>> {
        self.means_where(|frame, scores| scene(frame, scores) == Some(name))
    }

    /// Returns a table of scenes by methods for each of some metrics; none if there are too many scenes.
    pub fn by_scene(&self) -> Vec<Table> {
        let scenes = self.scenes();
        if scenes.is_empty() || scenes.len() > MOST {
            return Vec::new();
        }
        let means: Vec<_> = scenes
            .iter()
            .map(|(scene, count)| (format!("{scene} ({count})"), self.means_of_scene(scene)))
            .collect();
        let methods = &self.heading.methods;
        let table = |metric: Metric| Table {
            title: format!("{} by scene", metric.label()),
            row_header: "scene (frames)".to_owned(),
            ranking: Ranking::Columns,
            columns: methods
                .iter()
                .map(|method| Column::named(method, metric))
                .collect(),
            rows: means
                .iter()
                .map(|(label, means)| Row {
                    label: label.clone(),
                    unranked: false,
                    values: means.iter().map(|mean| Some(mean.mean[metric])).collect(),
                })
                .collect(),
        };
        METRICS.map(table).into()
    }
}

/// Returns the scene given by the dataset, or the folder in the name of the frame.
fn scene<'a>(frame: &'a str, scores: &'a FrameScores) -> Option<&'a str> {
    let folder = frame.rsplit_once('/').map(|(folder, _)| folder);
    scores.scene.as_deref().or(folder)
}
