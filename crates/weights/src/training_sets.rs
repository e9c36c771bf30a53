//! Training data of weights, with the licences that their owners state.

use crate::embedded_with;
use crate::history::{HistoryEntry, SourceWeights};
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::sync::LazyLock;

/// Whether the owners of data allow commercial use, the strictest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CommercialUse {
    /// They exclude it, or allow only research.
    No,
    /// They state no licence, or it is ambiguous.
    Unclear,
    /// They allow it.
    Yes,
}

impl CommercialUse {
    /// All values, the strictest first.
    pub const ALL: [Self; 3] = [Self::No, Self::Unclear, Self::Yes];

    /// Returns the name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::No => "no",
            Self::Unclear => "unclear",
            Self::Yes => "yes",
        }
    }
}

/// Training data of weights.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TrainingSet {
    /// Name of the data.
    pub name: String,
    /// Author or place of publication; `None` if not recorded.
    pub source: Option<String>,
    /// Licence, as stated by the owners or by the repository of the data.
    pub licence: String,
    /// Whether the licence allows commercial use.
    pub commercial_use: CommercialUse,
    /// Whether the data were only used for a calibration or the choice of a checkpoint, not to train a tensor.
    pub calibration_only: bool,
}

impl Display for TrainingSet {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.name)?;
        if let Some(source) = &self.source {
            write!(f, " ({source})")?;
        }
        let allowed = self.commercial_use.name();
        write!(f, ", licence: {}, commercial use: {allowed}", self.licence)?;
        if self.calibration_only {
            write!(f, ", calibration only")?;
        }
        Ok(())
    }
}

/// Name of the trained tensor of the depth head in [`named`].
pub const HEAD_TENSOR: &str = "depth head";

/// Licence of this tensor.
pub const HEAD_LICENCE: &str = "MIT OR Apache-2.0";

/// Name in [`named`] of weights like `anything` of the repository that are not built in: no tensor was trained on
/// non-commercial data.
pub const WITHOUT_NC: &str = "anything-without-nc";

/// Contents of [`WITHOUT_NC`], a [`weights_hash`](crate::weights_hash).
const WITHOUT_NC_CONTENTS: &str = "fb7ecbfafcfd678d";

/// Name of the pretrained encoder that weights may need ([`encoder_of`](crate::encoder_of)).
const ENCODER: &str = "encoder";

/// Training data of weights of the program.
#[derive(Deserialize)]
struct KnownSet {
    name: String,
    source: String,
    licence: String,
    commercial_use: CommercialUse,
    /// Names of the weights that were trained on it.
    trained: Vec<String>,
    /// Names of other weights that depend on it by a calibration or the choice of a checkpoint.
    calibrated: Vec<String>,
}

/// All known data, the strictest licence first. The tests read it.
static KNOWN_SETS: LazyLock<Vec<KnownSet>> =
    LazyLock::new(|| serde_json::from_str(include_str!("training_sets.json")).unwrap_or_default());

/// Returns the training data of weights of the program by their name, of [`WITHOUT_NC`] or of [`HEAD_TENSOR`], the strictest
/// licence first.
pub fn named(weights: &str) -> Vec<TrainingSet> {
    let has = |names: &[String]| names.iter().any(|name| name == weights);
    let used = KNOWN_SETS.iter();
    let used = used.filter(|set| has(&set.trained) || has(&set.calibrated));
    used.map(|set| TrainingSet {
        name: set.name.clone(),
        source: Some(set.source.clone()),
        licence: set.licence.clone(),
        commercial_use: set.commercial_use,
        calibration_only: !has(&set.trained),
    })
    .collect()
}

/// Returns the licence of weights of the program or of [`WITHOUT_NC`] by their contents
/// ([`weights_hash`](crate::weights_hash)), as an SPDX expression.
pub fn licence_of(contents: &str) -> Option<&'static str> {
    Some(known_with(contents)?.1)
}

/// Returns the name in [`named`] and the licence of weights with these contents.
fn known_with(contents: &str) -> Option<(&'static str, &'static str)> {
    if contents == WITHOUT_NC_CONTENTS {
        return Some((WITHOUT_NC, "MIT OR Apache-2.0"));
    }
    let weights = embedded_with(contents)?;
    Some((weights.name, weights.licence))
}

/// Returns the training data of weights by their contents ([`weights_hash`](crate::weights_hash)) and history, the
/// strictest licence first: data of the weights of the program that they were made from; data of Depth Anything V2 Small if
/// it was a teacher or they need its encoder; and their own data, whose licence is not recorded.
pub fn of(contents: &str, history: &[HistoryEntry], needs_encoder: bool) -> Vec<TrainingSet> {
    let mut sets = Vec::new();
    collect(&mut sets, contents, history);
    if needs_encoder {
        add_named(&mut sets, ENCODER);
    }
    sets.sort_by_key(|set| set.commercial_use);
    sets
}

fn collect(sets: &mut Vec<TrainingSet>, contents: &str, history: &[HistoryEntry]) {
    if let Some((name, _)) = known_with(contents) {
        add_named(sets, name);
        return;
    }
    // The preceding entries are those of the weights of the program.
    let starts_known = |entry: &HistoryEntry| {
        let mut starts = entry.sources.iter().filter(|source| source.role == "start");
        starts.any(|start| known_with(&start.contents).is_some())
    };
    let first = history.iter().rposition(starts_known).unwrap_or(0);
    for (index, entry) in history.iter().enumerate().skip(first) {
        let (found, frames) = (entry.data["found"].as_str(), entry.data["frames"].as_u64());
        if let (Some(found), Some(frames)) = (found, frames) {
            let mut set = not_recorded(format!("{frames} frames of {found}"));
            set.calibration_only = entry.command.starts_with("calibrate");
            add(sets, set);
        }
        // Also the encoder of a teacher.
        if entry.settings["network"]["extractor"]["encoder"].as_u64() > Some(0) {
            add_named(sets, ENCODER);
        }
        for source in &entry.sources {
            let is_known = known_with(&source.contents).is_some();
            // The preceding entries are the history of later starts.
            let has_history = !source.history.is_empty() || (source.role == "start" && index > 0);
            if is_known || has_history {
                collect(sets, &source.contents, &source.history);
            } else if is_depth_anything(source) {
                // The depth head of teachers contains the trained tensor.
                add_named(sets, HEAD_TENSOR);
            } else {
                add(
                    sets,
                    not_recorded(format!("{} `{}`", source.role, source.weights)),
                );
            }
        }
    }
}

/// Whether this is a teacher `depth-anything` or `depth-anything:SIDE`, rather than a file.
fn is_depth_anything(source: &SourceWeights) -> bool {
    let name = source.weights.split(':').next();
    source.role == "teacher" && name == Some("depth-anything")
}

fn not_recorded(name: String) -> TrainingSet {
    TrainingSet {
        name,
        source: None,
        licence: "not stated".to_owned(),
        commercial_use: CommercialUse::Unclear,
        calibration_only: false,
    }
}

/// Adds the training data of weights of the program, of [`HEAD_TENSOR`] or of [`ENCODER`].
fn add_named(sets: &mut Vec<TrainingSet>, weights: &str) {
    for set in named(weights) {
        add(sets, set);
    }
}

/// Adds data, or a further use of data that were added before.
fn add(sets: &mut Vec<TrainingSet>, set: TrainingSet) {
    match sets.iter_mut().find(|other| other.name == set.name) {
        Some(other) => other.calibration_only &= set.calibration_only,
        None => sets.push(set),
    }
}

/// Summarises data by licence in one line, the strictest first: `non-commercial data: A, B; data ...`.
pub fn summary(sets: &[TrainingSet]) -> String {
    let of_kind = |kind: CommercialUse| {
        let names = sets.iter().filter(|set| set.commercial_use == kind);
        let names = names.map(|set| {
            let remark = if set.calibration_only {
                " (calibration only)"
            } else {
                ""
            };
            format!("{}{remark}", set.name)
        });
        let names: Vec<String> = names.collect();
        let title = match kind {
            CommercialUse::No => "non-commercial data",
            CommercialUse::Unclear => "data without a clear licence",
            CommercialUse::Yes => "data that allows commercial use",
        };
        (!names.is_empty()).then(|| format!("{title}: {}", names.join(", ")))
    };
    let parts: Vec<String> = CommercialUse::ALL.into_iter().filter_map(of_kind).collect();
    if parts.is_empty() {
        return "data that is not recorded".to_owned();
    }
    parts.join("; ")
}

#[cfg(all(test, feature = "weights"))]
mod tests {
    use super::*;
    use crate::{embedded, weights_hash};
    use serde_json::{Value, json};
    use std::path::Path;

    fn names(sets: &[TrainingSet], kind: CommercialUse) -> Vec<&str> {
        let sets = sets.iter().filter(|set| set.commercial_use == kind);
        sets.map(|set| set.name.as_str()).collect()
    }

    fn entry(command: &str, found: &str, sources: Vec<SourceWeights>) -> HistoryEntry {
        HistoryEntry {
            command: command.to_owned(),
            program: Value::Null,
            sources,
            data: json!({ "found": found, "frames": 10 }),
            settings: Value::Null,
            seconds: 0.0,
            ended: String::new(),
        }
    }

    fn source(role: &str, contents: &str, history: Vec<HistoryEntry>) -> SourceWeights {
        SourceWeights {
            role: role.to_owned(),
            weights: format!("{role}.safetensors"),
            contents: contents.to_owned(),
            history,
        }
    }

    #[allow(clippy::unwrap_used)]
    fn contents(name: &str) -> String {
        weights_hash(Some(Path::new(name))).unwrap()
    }

    #[test]
    fn all_weights_of_the_program_have_their_data() {
        let sets = KNOWN_SETS.iter();
        assert!(sets.clone().map(|set| set.commercial_use).is_sorted());
        let built_in = embedded().iter().map(|weights| weights.name);
        let all: Vec<&str> = built_in.chain([WITHOUT_NC, HEAD_TENSOR, ENCODER]).collect();
        for name in sets.flat_map(|set| set.trained.iter().chain(&set.calibrated)) {
            assert!(all.contains(&name.as_str()), "{name}");
        }
        // Counted by hand in the lists of training frames of the weights.
        let indoors = "RGB-D-D, Replica, GQ-CNN examples";
        let photographs = ", SUN database, BSDS500, ImageNet samples, KITTI, nuScenes";
        for (weights, count, others) in [
            ("default", 23, photographs),
            ("small", 23, photographs),
            ("anything", 13, ", KITTI"),
            (HEAD_TENSOR, 19, ", SUN database, KITTI, nuScenes"),
        ] {
            let sets = named(weights);
            assert_eq!(sets.len(), count, "{weights}");
            let excluded = names(&sets, CommercialUse::No).join(", ");
            assert_eq!(excluded, format!("{indoors}{others}"), "{weights}");
            assert!(names(&sets, CommercialUse::Unclear).contains(&"NYU Depth v2"));
            assert!(sets.iter().any(|set| set.calibration_only), "{weights}");
        }
        for weights in embedded() {
            let needs_encoder = weights.read().unwrap().network.extractor.encoder > 0;
            let sets = of(&contents(weights.name), &[], needs_encoder);
            assert_eq!(sets, named(weights.name));
        }
        assert!(named("huge").is_empty());
    }

    #[test]
    fn one_file_was_trained_on_no_non_commercial_data() {
        let file = format!(
            "{}/../../assets/weights/{WITHOUT_NC}.safetensors",
            env!("CARGO_MANIFEST_DIR")
        );
        let contents = contents(&file);
        assert_eq!(licence_of(&contents), Some("MIT OR Apache-2.0"));
        // Those of `anything` without RGB-D-D, Replica and GQ-CNN examples.
        let sets = of(&contents, &[], true);
        assert_eq!(sets.len(), 13 - 3);
        assert_eq!(names(&sets, CommercialUse::No), ["KITTI"]);
        assert!(sets[0].calibration_only);
        let own = names(&sets, CommercialUse::Unclear);
        assert!(own.contains(&"NYU Depth v2"));
    }

    #[test]
    fn weights_inherit_the_data_of_those_that_they_were_made_from() {
        let own = "10 frames of a garden";
        let start = |contents: &str| vec![source("start", contents, Vec::new())];
        let history = [
            entry("train", "what `anything` was made from", Vec::new()),
            entry("train", "a garden", start(&contents("anything"))),
            entry("calibrate", "a street", start("0")),
        ];
        let sets = of("1", &history, false);
        assert_eq!(sets.len(), 13 + 2);
        assert!(sets.iter().map(|set| set.commercial_use).is_sorted());
        let find = |name: &str| sets.iter().find(|set| set.name == name).unwrap();
        assert_eq!(find(own).licence, "not stated");
        assert!(!find(own).calibration_only);
        assert!(find("10 frames of a street").calibration_only);
        assert_eq!(find("TUM RGB-D").licence, "CC BY 4.0");

        // The data of a teacher count, and unrecorded sources are listed.
        let sources = vec![
            source("teacher", "1", history.to_vec()),
            source("backbone", "2", Vec::new()),
        ];
        let taught = of("3", &[entry("train", "a garden", sources)], false);
        assert_eq!(taught.len(), 13 + 2 + 1);
        let unclear = names(&taught, CommercialUse::Unclear);
        assert!(unclear.contains(&"backbone `backbone.safetensors`"));
        assert!(unclear.contains(&own));
    }

    #[test]
    fn the_data_of_the_encoder_is_that_of_weights_on_it() {
        let encoder = "Depth Anything V2 Small";
        assert!(of("1", &[], false).is_empty());
        assert_eq!(
            names(&of("1", &[], true), CommercialUse::Unclear),
            [encoder]
        );

        // A network that was trained by a teacher on the encoder, from random weights.
        let taught_by = |channels: u64| {
            let network = json!({ "extractor": { "encoder": channels } });
            let teacher = HistoryEntry {
                settings: json!({ "network": network }),
                ..entry("train", "a garden", Vec::new())
            };
            let sources = vec![source("teacher", "1", vec![teacher])];
            of("2", &[entry("train", "a street", sources)], false)
        };
        let own = ["10 frames of a street", "10 frames of a garden"];
        assert_eq!(names(&taught_by(0), CommercialUse::Unclear), own);
        let sets = taught_by(64);
        assert_eq!(sets.len(), 3);
        assert!(names(&sets, CommercialUse::Unclear).contains(&encoder));
    }

    #[test]
    fn the_data_of_depth_anything_is_that_of_weights_that_it_taught() {
        let taught_by = |name: &str| {
            let teacher = SourceWeights {
                weights: name.to_owned(),
                ..source("teacher", "1", Vec::new())
            };
            of("2", &[entry("train", "a garden", vec![teacher])], false)
        };
        for name in ["depth-anything", "depth-anything:252"] {
            let sets = taught_by(name);
            // The data of the trained tensor in its head, and the garden.
            assert_eq!(sets.len(), 19 + 1, "{name}");
            let excluded = names(&sets, CommercialUse::No);
            assert_eq!(excluded, names(&named(HEAD_TENSOR), CommercialUse::No));
            let unclear = names(&sets, CommercialUse::Unclear);
            assert!(unclear.contains(&"Depth Anything V2 Small"));
            assert!(sets.iter().all(|set| !set.name.starts_with("teacher")));
        }
        // A file.
        let sets = taught_by("./depth-anything");
        assert_eq!(
            names(&sets, CommercialUse::Unclear),
            ["10 frames of a garden", "teacher `./depth-anything`"]
        );
    }

    #[test]
    fn the_strictest_licence_is_first() {
        let mut sets = named("anything");
        sets.retain(|set| ["NYU Depth v2", "TUM RGB-D"].contains(&set.name.as_str()));
        sets.push(TrainingSet {
            calibration_only: true,
            ..not_recorded("a street".to_owned())
        });
        let names: Vec<&str> = sets.iter().map(|set| set.name.as_str()).collect();
        assert_eq!(names, ["NYU Depth v2", "TUM RGB-D", "a street"]);
        assert_eq!(
            summary(&sets),
            "data without a clear licence: NYU Depth v2, a street (calibration only); \
             data that allows commercial use: TUM RGB-D"
        );
        assert_eq!(summary(&[]), "data that is not recorded");
        assert_eq!(
            sets[1].to_string(),
            "TUM RGB-D (Sturm et al. 2012), licence: CC BY 4.0, commercial use: yes"
        );
        assert_eq!(
            sets[2].to_string(),
            "a street, licence: not stated, commercial use: unclear, calibration only"
        );
    }
}
