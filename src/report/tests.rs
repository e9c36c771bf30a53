use super::*;
use crate::data::DepthMap;
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

fn record(i: usize, seed: u64) -> Record {
    let mut rng = Rng::stream(seed, &["record", &i.to_string()]);
    let mut outcome = || {
        let values = Metric::ALL.map(|_| f64::from(rng.unit()) / 3.0);
        let certainty = Certainty {
            within_one: u64::from(rng.below(99)),
            ..Certainty::default()
        };
        let mut bins = || vec![(u64::from(rng.below(9)), u64::from(rng.below(1000))).into()];
        Outcome {
            scores: Scores::default().map(|metric, _| values[metric as usize]),
            profile: Profile {
                depth: bins(),
                distance: bins(),
                error: bins(),
            },
            certainty: Some(certainty),
        }
    };
    Record {
        frame: format!("f{i}"),
        seed,
        points: 500,
        place: if i.is_multiple_of(2) {
            Place::Indoor
        } else {
            Place::Outdoor
        },
        outcomes: vec![outcome(), outcome()],
        files: Vec::new(),
    }
}

fn report(frames: impl Iterator<Item = usize>) -> Report {
    let mut report = Report::new(heading());
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
        let mut report = Report::new(heading());
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
    assert!(Curve::of(&[of(5, 0.5), Report::new(other)]).is_err());
    let mut refit = heading();
    refit.made_from = serde_json::json!({ "points": 5, "fit": { "method": "lse" } });
    let error = Curve::of(&[of(5, 0.5), Report::new(refit)]).unwrap_err();
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
    // Through a file, as shards go.
    let text = serde_json::to_string(&last.to_json()).unwrap();
    shards.join(Report::from_json(&text).unwrap()).unwrap();
    let shards = shards.complete().unwrap();
    assert_eq!(shards, whole);
    let json = |r: &Report| serde_json::to_string(&r.to_json()).unwrap();
    assert_eq!(json(&shards), json(&whole));
}

#[test]
fn what_does_not_belong_together_is_not_joined() {
    let mut a = report(0..3);
    assert!(a.join(report(2..4)).is_err());
    let mut other = Report::new(Heading {
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
    assert_eq!(report.places(), [Place::Indoor, Place::Outdoor]);
    let outdoor = &report.means(Some(Place::Outdoor))[0];
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
    let exhibit = Exhibit {
        role: "worst",
        frame: "f3".into(),
        rgb: RgbImage::new(3, 2),
        sparse: depth.clone(),
        truth: depth.clone(),
        predictions: vec![("a".into(), 0.25, depth.clone()), ("b".into(), 0.5, depth)],
    };
    let page = report.to_html(&[exhibit]);
    // Image, points, truth, and two pictures for each method.
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
    let marked = html::marked;
    assert_eq!(
        marked("SEE_5 of `a_1` & d1.25^3"),
        "SEE<sub>5</sub> of <code>a_1</code> &amp; d1.25<sup>3</sup>"
    );
    assert_eq!(marked("room_0001 and x^ `open"), "room_0001 and x^ `open");
}
