use super::systems::tests::recipes;
use super::*;
use burn::tensor::Device;
use lsdc_core::Completer;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::{ExtractorConfig, NetworkConfig};
use lsdc_eval::data::{Dataset, Frame, FrameId, Rooms, RoomsConfig, Split};
use lsdc_eval::metrics::Rules;
use lsdc_eval::sampling::{Pattern, Protocol, ProtocolPreset};
use lsdc_train::sample::SupervisionConfig;
use lsdc_train::training::TrainConfig;
use std::sync::Arc;

/// Returns a context with small rooms, and trainings of a few steps.
pub(super) fn context(folder: &Path) -> ExperimentContext {
    let config = RoomsConfig {
        train: 8,
        width: 64,
        height: 48,
        ..RoomsConfig::default()
    };
    let completer = Completer::new(&lsdc_core::Weights::builtin()).unwrap();
    let preset = ProtocolPreset {
        points: Pattern::Exactly(100),
        ..ProtocolPreset::named("full").unwrap()
    };
    let train = TrainConfig {
        steps: 2,
        batch: 2,
        held_out: 2,
        save_every: 1,
        protocol: Protocol::default(),
        supervision: SupervisionConfig {
            points: 300,
            fewest: 100,
            patches: 1,
            patch: 8,
            ..SupervisionConfig::default()
        },
        ..TrainConfig::default()
    };
    let network = NetworkConfig {
        extractor: ExtractorConfig::slim(),
        affinities: 0,
        ..NetworkConfig::sharp()
    };
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    ExperimentContext {
        folder: folder.to_owned(),
        dataset: "rooms val".into(),
        frames: Arc::new(Rooms::new(Split::Val, &config).unwrap()),
        preset,
        rules: Rules::default(),
        limit: Some(3),
        seeds: vec![0],
        completer,
        weights: "of the program".into(),
        network: NetworkConfig::sharp(),
        guides: None,
        predictions: Vec::new(),
        systems: Vec::new(),
        diode: None,
        recipe: Recipe {
            systems: recipes(&train),
            network,
            fit,
            train,
            frames: Box::new(move || Ok(Arc::new(Rooms::new(Split::Train, &config)?))),
        },
        device: (Device::flex(), "cpu".into()),
        place: serde_json::Value::Null,
        probe_time: Duration::ZERO,
    }
}

pub(super) fn go_on(_: ExperimentEvent<'_>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Returns the sections of experiments that are interrupted after some events, `more` events later every time.
pub(super) fn interrupted(
    experiments: &[Experiment],
    context: &ExperimentContext,
    more: usize,
) -> Vec<Section> {
    let mut stops = 0;
    loop {
        let mut left = more * (stops + 1);
        let found = run(experiments, context, |_| {
            left -= 1;
            if left == 0 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        if let Some(sections) = found.unwrap() {
            assert!(stops >= 2, "{stops} stops");
            return sections;
        }
        stops += 1;
    }
}

#[test]
fn an_interrupted_experiment_ends_with_the_same_bits() {
    let experiments = [Experiment::Ablation, Experiment::Benchmark];
    let whole = tempfile::tempdir().unwrap();
    let sections = run(&experiments, &context(whole.path()), go_on)
        .unwrap()
        .unwrap();
    let torn = tempfile::tempdir().unwrap();
    let again = interrupted(&experiments, &context(torn.path()), 7);
    assert_eq!(sections, again);
    for name in [
        "ablation.json",
        "benchmark.csv",
        "ablation-bases-rmse.svg",
        "benchmark-frame.png",
    ] {
        let bytes = |folder: &Path| std::fs::read(folder.join(name)).unwrap();
        assert!(bytes(whole.path()) == bytes(torn.path()), "{name}");
    }
}

#[test]
fn the_scale_of_the_depths_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let sections = run(&[Experiment::Scale], &context(folder.path()), go_on);
    let table = &sections.unwrap().unwrap()[0].tables[0];
    let spread = |column: usize| {
        let values = table.rows.iter().filter_map(|row| row.values[column]);
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        (high - low) / low
    };
    assert_eq!(table.columns[0].label, "lsdc");
    assert!(spread(0) < 1e-4, "{}", spread(0));
}

#[test]
fn a_folder_of_other_settings_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let first = context(folder.path());
    run(&[Experiment::Scale], &first, go_on).unwrap();
    let other = ExperimentContext {
        seeds: vec![1],
        ..context(folder.path())
    };
    assert!(run(&[Experiment::Scale], &other, go_on).is_err());
    // Settings of the fit and the location of frames are part of the record.
    let mut fit = *first.completer.fit_config();
    fit.joint.observation_precision *= 2.0;
    let refit = ExperimentContext {
        completer: first.completer.clone().with_fit(fit),
        ..context(folder.path())
    };
    let moved = ExperimentContext {
        place: serde_json::json!({ "folder": "/elsewhere" }),
        ..context(folder.path())
    };
    for (other, word) in [(refit, "fit.joint.data"), (moved, "place")] {
        let error = run(&[Experiment::Scale], &other, go_on).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    }
    let mut resumed = 0;
    run(&[Experiment::Scale], &first, |event| {
        if let ExperimentEvent::Resumed(count) = event {
            resumed = count;
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(resumed >= 3, "{resumed} results used again");
    // The record of trained networks also includes their recipe.
    let mut events = 0;
    run(&[Experiment::Ablation], &first, |_| {
        events += 1;
        if events < 30 {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    })
    .unwrap();
    let mut longer = context(folder.path());
    longer.recipe.train.steps += 1;
    assert!(run(&[Experiment::Ablation], &longer, go_on).is_err());
    remove_results(folder.path()).unwrap();
    assert!(run(&[Experiment::Scale], &other, go_on).unwrap().is_some());
}

#[test]
fn experiments_without_their_data_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let sections = run(&[Experiment::Diode], &context(folder.path()), go_on)
        .unwrap()
        .unwrap();
    assert!(sections[0].tables.is_empty());
    assert!(
        sections[0].about[0].contains("--diode"),
        "{}",
        sections[0].about[0]
    );
}

/// Rooms with a frame that cannot be read.
struct Torn(Rooms);

impl Dataset for Torn {
    fn description(&self) -> String {
        self.0.description()
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.0.id(index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        if index == 1 {
            return Err(Error::config("torn"));
        }
        self.0.load(index)
    }
}

#[test]
fn frames_that_fail_are_named_once() {
    let folder = tempfile::tempdir().unwrap();
    let whole = context(folder.path());
    let config = RoomsConfig {
        width: 64,
        height: 48,
        ..RoomsConfig::default()
    };
    let frames = Torn(Rooms::new(Split::Val, &config).unwrap());
    let name = frames.id(1).clone();
    let context = ExperimentContext {
        frames: Arc::new(frames),
        ..whole
    };
    let sections = run(&[Experiment::Scale], &context, go_on).unwrap().unwrap();
    let failed = &sections[0].failures;
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert_eq!((&failed[0].frame, &*failed[0].error), (&name, "torn"));
    let text = std::fs::read_to_string(folder.path().join("scale.txt")).unwrap();
    assert!(text.contains(&format!("- {name}: torn")), "{text}");
}
