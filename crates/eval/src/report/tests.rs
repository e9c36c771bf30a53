use super::*;
use crate::data::DepthMap;
use crate::metrics::{ErrorCount, RANGE_STARTS};
use image::RgbImage;
use lsdc_rng::Rng;

fn heading() -> Heading {
    Heading {
        dataset: "made up".into(),
        seeds: vec![0, 1],
        methods: vec!["a".into(), "b".into()],
        frames: 9,
        ..Heading::default()
    }
}

fn record(i: usize, seed: u64) -> FrameRecord {
    let mut rng = Rng::stream(seed, &["record", &i.to_string()]);
    let mut outcome = || {
        let values = Metric::ALL.map(|_| f64::from(rng.unit()) / 3.0);
        let uncertainty = UncertaintyScores {
            within_one: u64::from(rng.below(99)),
            ..UncertaintyScores::default()
        };
        let mut counts = [ErrorCount::default(); RANGE_STARTS.len()];
        for count in &mut counts {
            *count = [(); 6].map(|()| 1 + u64::from(rng.below(9))).into();
        }
        let ranges = DepthRangeErrors {
            all: counts,
            certain: None,
        };
        let mut bins = || vec![(u64::from(rng.below(9)), u64::from(rng.below(1000))).into()];
        MethodOutcome {
            scores: Scores::default().map(|metric, _| values[metric as usize]),
            profile: ErrorProfile {
                depth: bins(),
                distance: bins(),
                error: bins(),
            },
            uncertainty: Some(uncertainty),
            ranges,
        }
    };
    FrameRecord {
        frame: format!("f{i}"),
        seed,
        points: 500,
        place: if i.is_multiple_of(2) {
            Environment::Indoor
        } else {
            Environment::Outdoor
        },
        scene: (i < 2).then(|| "hall".to_owned()),
        outcomes: vec![outcome(), outcome()],
        files: Vec::new(),
    }
}

fn report(frames: impl Iterator<Item = usize>) -> EvaluationReport {
    let mut report = EvaluationReport::new(heading());
    for i in frames {
        for seed in [0, 1] {
            report.add(record(i, seed)).unwrap();
        }
    }
    report
}

#[test]
fn a_curve_runs_from_few_points_to_many() {
    let of = |points: usize, rmse: f64| {
        let mut report = EvaluationReport::new(heading());
        for i in 0..3 {
            let mut record = record(i, 0);
            record.points = points;
            for outcome in &mut record.outcomes {
                outcome.scores = Scores::default().map(|_, _| rmse);
            }
            report.add(record).unwrap();
        }
        report
    };
    let curve = Curve::of(&[of(500, 0.25), of(5, 0.75)]).unwrap();
    let text = curve.to_string();
    let lines: Vec<Vec<&str>> = text
        .lines()
        .map(|l| l.split_whitespace().collect())
        .collect();
    assert_eq!(lines[0], ["RMSE", "a", "b"]);
    assert_eq!(lines[1], ["5", "0.7500", "0.7500"]);
    assert_eq!(lines[2], ["500", "0.2500", "0.2500"]);
    let mut other = heading();
    other.dataset = "another".into();
    assert!(Curve::of(&[of(5, 0.5), EvaluationReport::new(other)]).is_err());
    let mut refit = heading();
    refit.made_from = serde_json::json!({ "points": 5, "fit": { "method": "lse" } });
    let error = Curve::of(&[of(5, 0.5), EvaluationReport::new(refit)]).unwrap_err();
    assert!(error.to_string().contains("made_from"), "{error}");
    assert!(Curve::of(&[]).is_err());
}

#[test]
fn joined_shards_are_the_whole_bit_for_bit() {
    let whole = report(0..9);
    let part = |index: usize, frames: [usize; 3]| {
        let shard = format!("{index}/3").parse().unwrap();
        report(frames.into_iter()).of_part(shard)
    };
    let mut shards = part(1, [8, 1, 5]);
    shards.join(part(0, [0, 7, 3])).unwrap();
    let missing = shards.clone().complete().unwrap_err().to_string();
    assert!(missing.contains("2-of-3"), "{missing}");
    let last = part(2, [6, 4, 2]);
    // Through JSON, as shards are exchanged.
    let text = serde_json::to_string(&last.to_json()).unwrap();
    shards
        .join(EvaluationReport::from_json(&text).unwrap())
        .unwrap();
    let shards = shards.complete().unwrap();
    assert_eq!(shards, whole);
    let json = |r: &EvaluationReport| serde_json::to_string(&r.to_json()).unwrap();
    assert_eq!(json(&shards), json(&whole));
}

#[test]
fn what_does_not_belong_together_is_not_joined() {
    let mut a = report(0..3);
    assert!(a.join(report(2..4)).is_err());
    let mut other = EvaluationReport::new(Heading {
        points: "others".into(),
        ..heading()
    });
    other.add(record(8, 0)).unwrap();
    assert!(a.join(other).is_err());
}

#[test]
fn means_are_over_frames_then_over_seeds() {
    let report = report(0..5);
    let of = |seed: u64| {
        (0..5)
            .map(|i| record(i, seed).outcomes[1].scores[Metric::Rmse])
            .sum::<f64>()
            / 5.0
    };
    let mean = &report.means(None)[1];
    assert!((mean.mean[Metric::Rmse] - 0.5 * (of(0) + of(1))).abs() < 1e-12);
    let spread = (of(0) - of(1)).abs() / 2.0_f64.sqrt();
    assert!((mean.deviation[Metric::Rmse] - spread).abs() < 1e-12);
    assert_eq!(report.count(), 5);
    assert_eq!(report.places(), [Environment::Indoor, Environment::Outdoor]);
    let outdoor = &report.means(Some(Environment::Outdoor))[0];
    let expected = (0..2_u64)
        .flat_map(|seed| [1, 3].map(|i| record(i, seed).outcomes[0].scores[Metric::Mae]))
        .sum::<f64>();
    assert!((outdoor.mean[Metric::Mae] - expected / 4.0).abs() < 1e-12);
}

#[test]
fn the_page_shows_everything_and_loads_nothing() {
    let mut report = report(0..9);
    report.heading.weights = Some("`default` of the program".into());
    let depth = DepthMap::new(3, 2, vec![1.0, 2.0, 0.0, 3.0, 1.0, 2.0]).unwrap();
    let example = ExampleFrame {
        role: "worst",
        frame: "f3".into(),
        rgb: RgbImage::new(3, 2),
        sparse: depth.clone(),
        truth: depth.clone(),
        predictions: vec![("a".into(), 0.25, depth.clone()), ("b".into(), 0.5, depth)],
    };
    let page = report.to_html(&[example]);
    // Image, points, truth, and two pictures per method.
    assert_eq!(page.matches("data:image/png;base64,").count(), 7);
    for word in [
        "made up",
        "RMSE",
        "against depth",
        "worst: f3",
        "5 points",
        "a, RMSE 0.250 m",
        "b, error",
        "nearest point",
        "SEE<sub>3</sub> where",
        "d1.25<sup>2</sup>",
        "<code>default</code> of the program",
        "prefers-color-scheme: dark",
        "</html>",
    ] {
        assert!(page.contains(word), "{word}");
    }
    assert!(
        !page.contains("http://")
            || page.matches("http://").count() == page.matches("http://www.w3.org/").count()
    );
    assert!(!page.contains("https://") && !page.contains("<script"));
    assert!(!page.contains("NaN"));
    assert!(!page.contains('`') && !page.contains("SEE_") && !page.contains("25^"));
    // Depth and error of a method follow each other, so that columns or rows compare methods.
    let captions: Vec<&str> = page
        .split("<figcaption>")
        .skip(4)
        .filter_map(|text| text.split("</").next())
        .collect();
    let expected = ["a, RMSE 0.250 m", "a, error", "b, RMSE 0.500 m", "b, error"];
    assert_eq!(captions, expected);
}

#[test]
fn marks_of_plain_text_become_elements() {
    let markup = html::markup;
    assert_eq!(
        markup("SEE_5 of `a_1` & d1.25^3"),
        "SEE<sub>5</sub> of <code>a_1</code> &amp; d1.25<sup>3</sup>"
    );
    assert_eq!(markup("room_0001 and x^ `open"), "room_0001 and x^ `open");
}

#[test]
fn scenes_are_what_datasets_name_or_folders() {
    // Two frames of the hall, and others without a scene.
    assert!(report(0..4).scenes().is_empty());
    let mut known = EvaluationReport::new(heading());
    for i in 0..5 {
        for seed in [0, 1] {
            let mut record = record(i, seed);
            record.frame = format!("yard/f{i}");
            known.add(record).unwrap();
        }
    }
    let scenes: Vec<_> = known.scenes().into_iter().collect();
    assert_eq!(scenes, [("hall", 2), ("yard", 3)]);
    let tables = known.by_scene();
    let titles: Vec<&str> = tables.iter().map(|table| table.title.as_str()).collect();
    assert_eq!(titles, ["RMSE by scene", "MAE by scene", "REL by scene"]);
    let row = &tables[1].rows[1];
    assert_eq!(row.label, "yard (3)");
    let sum: f64 = (0..2)
        .flat_map(|seed| (2..5).map(move |i| record(i, seed)))
        .map(|record| record.outcomes[1].scores[Metric::Mae])
        .sum();
    assert!((row.values[1].unwrap() - sum / 6.0).abs() < 1e-12);
    let json = known.to_json();
    let mae = &json["scenes"]["yard"]["b"]["mean"]["mae"];
    assert!((mae.as_f64().unwrap() - sum / 6.0).abs() < 1e-12);
    let again = EvaluationReport::from_json(&json.to_string()).unwrap();
    assert_eq!(again.scenes(), known.scenes());
}

/// Returns a report of one frame with these numbers of pixels by depth, each with an error of 2 m and 1 % of the depth.
fn counted(pixels: [u64; RANGE_STARTS.len()], certain: bool) -> EvaluationReport {
    let mut report = EvaluationReport::new(Heading {
        sigma_cut: certain.then_some(0.1),
        ..heading()
    });
    let count = |n: u64, missed: u64| [n, n * 4_000_000, n * 2_000_000, n * 10_000, n / 2, missed];
    let mut record = record(0, 0);
    for outcome in &mut record.outcomes {
        outcome.ranges = DepthRangeErrors {
            all: pixels.map(|n| count(n, n / 4).into()),
            certain: None,
        };
    }
    if certain {
        let certain = pixels.map(|n| count(n / 2, 0).into());
        record.outcomes[0].ranges.certain = Some(certain);
    }
    report.add(record).unwrap();
    report
}

#[test]
fn errors_are_tabled_by_the_ranges_that_have_pixels() {
    let tables = counted([300, 0, 100, 0, 0], true).by_depth();
    let titles: Vec<&str> = tables.iter().map(|table| table.title.as_str()).collect();
    let expected = [
        "all depths, 400 pixels",
        "0 to 10 m, 300 pixels (75.0 %)",
        "20 to 40 m, 100 pixels (25.0 %)",
    ];
    assert_eq!(titles, expected);
    // RMSE, MAE, REL, phantom, missed; kept, and both rates of the kept pixels.
    let rounded = |row: &Row| -> Vec<Option<f64>> {
        let rounded = |v: f64| (v * 1e6).round() / 1e6;
        row.values.iter().map(|v| v.map(rounded)).collect()
    };
    let all = [2.0, 2.0, 0.01, 50.0, 25.0, 50.0, 50.0, 0.0].map(Some);
    assert_eq!(rounded(&tables[2].rows[0]), all);
    let other = [&all[..5], &[None; 3]].concat();
    assert_eq!(rounded(&tables[2].rows[1]), other);
    let report = counted([300, 0, 100, 0, 0], true);
    let text = report.to_string();
    assert!(text.contains("at most 0.1 x the predicted depth"), "{text}");
    // A single range repeats the means.
    assert!(counted([300, 0, 0, 0, 0], false).by_depth().is_empty());
    assert_eq!(counted([300, 0, 0, 0, 0], true).by_depth().len(), 1);
    assert!(!counted([9, 9, 0, 0, 0], false).to_string().contains("kept"));
}
