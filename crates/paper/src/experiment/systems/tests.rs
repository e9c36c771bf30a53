use crate::experiment::tests::{context, go_on, interrupted};
use crate::experiment::{Experiment, SystemRecipe, run};
use crate::systems::SystemConfig;
use lsdc_train::training::{LossConfig, TrainConfig};

/// Returns a tiny recipe for each system.
pub(in crate::experiment) fn recipes(train: &TrainConfig) -> Vec<SystemRecipe> {
    let recipes = [
        r#"{ "method": "s2d", "encoder": "resnet18", "width": 4 }"#,
        r#"{ "method": "cspn", "encoder": "resnet18", "width": 4, "steps": 3 }"#,
        r#"{ "method": "lsk", "width": 2, "neighbours": 6 }"#,
    ];
    let recipe = |text: &&str| {
        let system: SystemConfig = serde_json::from_str(text).unwrap();
        SystemRecipe {
            name: system.kind().name().to_owned(),
            system,
            train: TrainConfig {
                calibrate: false,
                loss: LossConfig {
                    regularisation: 0.0,
                    ..train.loss
                },
                ..train.clone()
            },
        }
    };
    recipes.iter().map(recipe).collect()
}

#[test]
fn systems_are_trained_and_measured_alike_interrupted_or_not() {
    let whole = tempfile::tempdir().unwrap();
    let experiments = [Experiment::Systems];
    let sections = run(&experiments, &context(whole.path()), go_on);
    let sections = sections.unwrap().unwrap();
    let table = &sections[0].tables[0];
    let labels: Vec<&str> = table.rows.iter().map(|row| row.label.as_str()).collect();
    assert_eq!(
        labels[..7],
        [
            "lsdc",
            "lsdc, same budget",
            "s2d",
            "cspn",
            "lsk",
            "steering",
            "linear"
        ]
    );
    assert!(table.rows[7..].iter().all(|row| row.unranked));
    let text = sections[0].to_string();
    for words in [
        "s2d: published RMSE 0.204 m, here",
        "random weights, where the authors start from",
        "2 steps of 2 images",
        "37.956 M of layers",
    ] {
        assert!(text.contains(words), "`{words}` is missing in: {text}");
    }
    // Scaled points scale the depths of `lsdc`, but not those of networks trained on other depths.
    let scaled = sections[0]
        .tables
        .iter()
        .find(|t| t.title.starts_with("Scaled"));
    let rows = &scaled.unwrap().rows;
    let of = |row: usize, column: usize| rows[row].values[column].unwrap();
    assert!((of(0, 0) / of(2, 0) - 1.0).abs() < 1e-3);
    assert!((of(0, 2) / of(1, 2) - 1.0).abs() > 1e-2);

    let torn = tempfile::tempdir().unwrap();
    let again = interrupted(&experiments, &context(torn.path()), 20);
    let (last, first) = (again[0].tables.len() - 1, &sections[0]);
    // The last table has times, which differ.
    assert_eq!(first.tables[..last], again[0].tables[..last]);
    assert_eq!(first.findings, again[0].findings);
}
