//! `lsdc experiment`.

use super::*;

const ARGS: [&str; 8] = [
    "experiment",
    "cost",
    "kernels",
    "--dataset",
    "rooms",
    "-o",
    "out",
    "--limit=1",
];

#[test]
fn experiments_write_tables_pictures_and_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let run = lsdc(folder.path()).args(ARGS).assert().success();
    let printed = text(&run);
    for word in ["Parameters and times", "LSE, this method (table 5)", "3.47"] {
        assert!(printed.contains(word), "{word}: {printed}");
    }
    let out = folder.path().join("out");
    let cost = json(&out.join("cost.json"));
    let rows = cost["tables"][0]["rows"].as_array().unwrap();
    let paper = rows
        .iter()
        .find(|row| row["label"] == "the paper's network and fit")
        .unwrap();
    // 3,466,016 parameters, counted by hand from PSMNet's source; times are above 0.
    assert!((paper["values"][0].as_f64().unwrap() - 3.466_016).abs() < 1e-9);
    assert!(paper["values"][5].as_f64().unwrap() > 0.0);
    let csv = std::fs::read_to_string(out.join("cost.csv")).unwrap();
    assert!(
        csv.starts_with("\"method\",\"aside\",\"parameters, M\""),
        "{csv}"
    );
    for name in ["kernels-kernels", "kernels-functions", "cost-times"] {
        let svg = std::fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        let size = |key: &str| {
            let rest = svg.split(&format!(" {key}='")).nth(1).unwrap();
            rest.split('\'').next().unwrap().parse::<f64>().unwrap()
        };
        let png = image::open(out.join(format!("{name}.png"))).unwrap();
        let doubled = |length: f64| (2.0 * length).ceil() as u32;
        assert_eq!(png.width(), doubled(size("width")), "{name}");
        assert_eq!(png.height(), doubled(size("height")), "{name}");
    }
    let page = std::fs::read_to_string(out.join("kernels-cost.html")).unwrap();
    assert!(page.contains("id='kernels'") && page.contains("id='cost'"));

    // Earlier measurements are kept.
    let first = std::fs::read(out.join("cost.json")).unwrap();
    lsdc(folder.path()).args(ARGS).assert().success();
    assert!(first == std::fs::read(out.join("cost.json")).unwrap());
}

#[test]
fn experiments_are_known_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["experiment", "table9", "-o", "out", "--dataset", "rooms"];
    refused(folder.path(), &args, &["table9"]);
    let args = ["experiment", "points", "-o", "out", "--dataset", "nyu"];
    refused(folder.path(), &args, &["needs a folder", "--root"]);
}
