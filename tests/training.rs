//! Training runs give the same bits for the same seed, interrupted or not.

#![allow(clippy::unwrap_used)]

use assert_cmd::Command;
use std::path::Path;

const CONFIG: &str = r#"
preset = "small"

[network]
octaves = 3
hidden = [32]
bases = 24
extractor = { stem = 8, stages = [
    { width = 8, blocks = 1 }, { width = 16, blocks = 1 },
    { width = 16, blocks = 1 }, { width = 16, blocks = 1 },
], branch = 8, merge = 16, features = 16 }

[fit]
ridge = 1e-4

[data.rooms]
train = 12
width = 64
height = 48

[train]
steps = 6
batch = 2
learning_rate = 1e-3
save_every = 3
measure_every = 3
held_out = 2
protocol = {}
supervision = { points = 200, fewest = 100, draws = 2, patches = 4, patch = 8 }
"#;

fn train(folder: &Path, args: &[&str]) {
    let run = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(folder)
        .arg("train")
        .args(args)
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
}

fn bytes(folder: &Path, run: &str) -> Vec<u8> {
    std::fs::read(folder.join(run).join("checkpoints/00000006/network.bpk")).unwrap()
}

/// Lines of the log without the times of steps.
fn losses(folder: &Path, run: &str) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join(run).join("metrics.jsonl")).unwrap();
    let strip = |line: &str| line.split(",\"seconds\"").next().unwrap().to_owned();
    text.lines().map(strip).collect()
}

/// [`CONFIG`] with the joint fit, learned affinities, averaged weights, and further losses.
fn joint() -> String {
    CONFIG
        .replace("octaves = 3", "octaves = 3\naffinities = 8")
        .replace("ridge = 1e-4", "method = \"joint\"")
        .replace("held_out = 2", "held_out = 2\naverage = 0.9")
        + "loss = { rmse = 1.0, affinities = 0.1 }\n"
}

#[test]
fn seed_workers_and_interruptions_do_not_change_the_bits() {
    unchanged(CONFIG);
}

#[test]
fn nor_do_they_through_the_joint_fit() {
    unchanged(&joint());
}

#[test]
fn nor_do_they_with_muon() {
    unchanged(&CONFIG.replace("held_out = 2", "held_out = 2\noptimiser = \"muon\""));
}

/// Configuration of a small version of a system in the paper's comparison.
fn system(settings: &str, optimiser: &str) -> String {
    format!(
        r#"
[system]
{settings}

[data.rooms]
train = 8
width = 64
height = 48

[train]
steps = 6
batch = 2
optimiser = "{optimiser}"
learning_rate = 1e-3
save_every = 3
measure_every = 3
held_out = 2
average = 0.9
calibrate = false
protocol = {{}}
loss = {{ l2 = 0.0, berhu = 1.0, gradient = 0.0, regularisation = 0.0 }}
supervision = {{ points = 200, fewest = 100, draws = 2 }}
"#
    )
}

const SYSTEMS: [(&str, &str); 4] = [
    ("s2d", "method = \"s2d\"\nencoder = \"resnet18\"\nwidth = 4"),
    (
        "cspn",
        "method = \"cspn\"\nencoder = \"resnet18\"\nwidth = 4\nsteps = 4",
    ),
    ("lsk", "method = \"lsk\"\nwidth = 2\nneighbours = 8"),
    (
        "lsk",
        "method = \"lsk\"\nkernels = \"ours\"\norder = 1\nbounded = false\nrefine = false\n\
         network = { hidden = [16], extractor = { stem = 8, stages = [ \
         { width = 8, blocks = 1 }, { width = 16, blocks = 1 }, \
         { width = 16, blocks = 1 }, { width = 16, blocks = 1 } ], \
         branch = 8, merge = 16, features = 16 } }",
    ),
];

#[test]
fn nor_do_they_for_systems() {
    for (optimiser, (_, settings)) in ["sgd", "adam", "adam", "muon"].into_iter().zip(SYSTEMS) {
        unchanged(&system(settings, optimiser));
    }
}

#[test]
fn trained_systems_complete() {
    for (number, (name, settings)) in SYSTEMS.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        std::fs::write(at.join("c.toml"), system(settings, "adam")).unwrap();
        let short = ["--config", "c.toml", "-o", "a", "--set", "train.steps=2"];
        train(at, &[&["--method", name][..], &short].concat());
        let run = |args: &[&str]| {
            let program = env!("CARGO_BIN_EXE_lsdc");
            let output = Command::new(program).current_dir(at).args(args).output();
            let output = output.unwrap();
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            (
                output.status.code(),
                String::from_utf8(output.stdout).unwrap() + &said,
            )
        };
        let weights = "a/weights.safetensors";
        let (code, text) = run(&["weights", "info", weights]);
        assert_eq!(code, Some(0), "{text}");
        for words in [
            name,
            "start      all weights at random",
            "2 steps",
            "held out",
        ] {
            assert!(text.contains(words), "`{words}` is missing in: {text}");
        }
        let data = ["--dataset", "rooms", "--set", "data.rooms.width=64"];
        let eval = |args: &[&str]| {
            let whole = [
                &["eval", "--limit", "1", "--set", "data.rooms.height=48"],
                &data[..],
                args,
            ];
            run(&whole.concat())
        };
        let method = ["--method", name, "--weights", weights];
        let (code, text) = eval(&[&method[..], &["--save", "saved"]].concat());
        assert_eq!(code, Some(0), "{text}");
        let (code, text) = eval(&["--system", &format!("mine={weights}"), "--method", "linear"]);
        assert_eq!(code, Some(0), "{text}");
        assert!(text.contains("mine") && text.contains("linear"), "{text}");

        // The same frame completed directly, and a frame of another size.
        let export = ["export", "-o", "frames", "--limit", "1"];
        let (code, text) = run(&[&export[..], &data, &["--set", "data.rooms.height=48"]].concat());
        assert_eq!(code, Some(0), "{text}");
        let only = |folder: &str| {
            let mut files = Vec::new();
            let mut folders = vec![at.join(folder)];
            while let Some(folder) = folders.pop() {
                for entry in std::fs::read_dir(folder).unwrap() {
                    let path = entry.unwrap().path();
                    let list = if path.is_dir() {
                        &mut folders
                    } else {
                        &mut files
                    };
                    list.push(path);
                }
            }
            files.pop().unwrap()
        };
        let (rgb, sparse) = (only("frames/rgb"), only("frames/sparse"));
        let (rgb, sparse) = (rgb.to_str().unwrap(), sparse.to_str().unwrap());
        let complete = ["complete", rgb, sparse, "-o", "depth.npy"];
        let (code, text) = run(&[&complete[..], &method].concat());
        assert_eq!(code, Some(0), "{text}");
        let depths = |path: &Path| {
            let npy = npyz::NpyFile::new(std::fs::File::open(path).unwrap()).unwrap();
            npy.into_vec::<f32>().unwrap()
        };
        let found = depths(&at.join("depth.npy"));
        assert_eq!(found.len(), 64 * 48);
        assert_eq!(found, depths(&only("saved")));

        // Options that conflict.
        let (code, text) = run(&[&complete[..], &["--force", "--weights", weights]].concat());
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains("--method"), "{text}");
        let (code, text) = eval(&["--method", name]);
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains("lsdc train --method"), "{text}");
        let other = if number == 0 { "cspn" } else { "s2d" };
        let (code, text) = eval(&["--method", other, "--weights", weights]);
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains(name), "{text}");
    }
}

#[test]
fn systems_have_no_settings_of_basis_functions() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = system(SYSTEMS[0].1, "adam");
    for (wrong, words) in [
        ("calibrate = true", "calibrate"),
        ("part = \"bases\"\ncalibrate = false", "part"),
    ] {
        std::fs::write(
            at.join("c.toml"),
            config.replace("calibrate = false", wrong),
        )
        .unwrap();
        let run = Command::new(env!("CARGO_BIN_EXE_lsdc"))
            .current_dir(at)
            .args(["train", "--config", "c.toml", "-o", "a"])
            .output()
            .unwrap();
        let said = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(2), "{said}");
        assert!(said.contains(words) && said.contains("s2d"), "{said}");
    }
}

fn unchanged(config: &str) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), config).unwrap();
    train(at, &["--config", "c.toml", "-o", "a"]);
    train(
        at,
        &["--config", "c.toml", "-o", "b", "--set", "train.workers=3"],
    );
    assert_eq!(losses(at, "a"), losses(at, "b"));

    // Simulate a run killed after its third step: later steps are lost and computed again.
    train(at, &["--config", "c.toml", "-o", "c"]);
    std::fs::remove_dir_all(at.join("c/checkpoints/00000006")).unwrap();
    std::fs::remove_file(at.join("c/weights.safetensors")).unwrap();
    train(at, &["--resume", "c"]);
    assert_eq!(losses(at, "a"), losses(at, "c"));

    let weights = |run: &str| std::fs::read(at.join(run).join("weights.safetensors")).unwrap();
    let tensors = |run: &str| {
        let bytes = weights(run);
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut tensors: Vec<_> = file
            .tensors()
            .into_iter()
            .map(|(name, t)| (name, t.data().to_vec()))
            .collect();
        tensors.sort();
        tensors
    };
    assert_eq!(tensors("a"), tensors("b"));
    assert_eq!(tensors("a"), tensors("c"));
    assert!(!bytes(at, "c").is_empty());

    train(at, &["--config", "c.toml", "-o", "d", "--seed", "1"]);
    assert_ne!(tensors("a"), tensors("d"));
}

#[test]
fn several_devices_divide_every_batch() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), CONFIG).unwrap();
    let both = ["--config", "c.toml", "--device", "cpu,cpu"];
    train(at, &[&both[..], &["-o", "a"]].concat());
    train(at, &[&both[..], &["-o", "b"]].concat());
    assert_eq!(losses(at, "a"), losses(at, "b"));
    assert!(losses(at, "a").len() >= 6);

    let too_many = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args([
            "train",
            "--config",
            "c.toml",
            "-o",
            "c",
            "--device",
            "cpu,cpu,cpu",
        ])
        .output()
        .unwrap();
    assert_eq!(too_many.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&too_many.stderr).contains("batch of 2"));
    assert!(!at.join("c").exists());
}

/// Trains one step of [`CONFIG`], written to `c.toml`, into the folder `a`.
fn train_one_step(at: &Path) {
    std::fs::write(at.join("c.toml"), CONFIG).unwrap();
    train(
        at,
        &["--config", "c.toml", "-o", "a", "--set", "train.steps=1"],
    );
}

#[test]
fn a_run_folder_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    train_one_step(at);
    for name in [
        "config.toml",
        "data.json",
        "env.json",
        "metrics.jsonl",
        "weights.safetensors",
    ] {
        assert!(at.join("a").join(name).exists(), "{name}");
    }
    let again = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args(["train", "--config", "c.toml", "-o", "a"])
        .output()
        .unwrap();
    assert_eq!(again.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&again.stderr).contains("--resume"));
}

#[test]
fn a_run_does_not_go_on_with_other_frames() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    train_one_step(at);
    let resume = || {
        Command::new(env!("CARGO_BIN_EXE_lsdc"))
            .current_dir(at)
            .args(["train", "--resume", "a"])
            .output()
            .unwrap()
    };
    let settings = at.join("a/config.toml");
    let text = std::fs::read_to_string(&settings).unwrap();
    std::fs::write(&settings, text.replace("train = 12", "train = 10")).unwrap();
    let other = resume();
    let said = String::from_utf8(other.stderr).unwrap();
    assert_eq!(other.status.code(), Some(2), "{said}");
    for words in ["a/data.json", "frames: 12, now 10", "names: ", "hint:"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    // A run without a record gets a warning and, from then on, a record.
    std::fs::remove_file(at.join("a/data.json")).unwrap();
    let unknown = resume();
    let said = String::from_utf8(unknown.stderr).unwrap();
    assert!(unknown.status.success(), "{said}");
    assert!(said.contains("data.json` is missing"), "{said}");
    assert!(at.join("a/data.json").exists());
}

#[test]
fn curves_of_runs_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), CONFIG).unwrap();
    train(
        at,
        &[
            "--config",
            "c.toml",
            "-o",
            "a",
            "--set",
            "train.calibrate=false",
        ],
    );
    let report = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lsdc"));
        command
            .current_dir(at)
            .args(["report", "training"])
            .args(args)
            .output()
            .unwrap()
    };
    let shown = report(&["a", "--html", "page.html"]);
    let text = String::from_utf8(shown.stdout).unwrap();
    let row: Vec<&str> = text.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(row[..2], ["a", "6"], "{text}");
    assert!(row[4].parse::<f64>().unwrap() > 0.0, "{text}");
    assert!(at.join("page.html").exists());
    assert_eq!(report(&["a", "--html", "page.html"]).status.code(), Some(2));
    assert_eq!(report(&["nowhere"]).status.code(), Some(2));
}

#[test]
fn trained_weights_complete() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), joint()).unwrap();
    train(
        at,
        &["--config", "c.toml", "-o", "a", "--set", "train.steps=2"],
    );
    let info = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args(["weights", "info", "a/weights.safetensors"])
        .output()
        .unwrap();
    let text = String::from_utf8(info.stdout).unwrap();
    for words in [
        "learned affinities",
        "edge-aware field",
        "learned prior",
        "2 steps",
        "held out",
    ] {
        assert!(text.contains(words), "`{words}` is missing in: {text}");
    }
    Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args([
            "eval",
            "--dataset",
            "rooms",
            "--limit",
            "1",
            "--method",
            "lsdc",
        ])
        .args(["--weights", "a/weights.safetensors"])
        .assert()
        .success();
}

/// Bytes of the network's tensors in a weights file, by name.
fn tensors(path: &Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let bytes = std::fs::read(path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let tensors = file.tensors().into_iter();
    let named = tensors.map(|(name, tensor)| (name, tensor.data().to_vec()));
    named
        .filter(|(name, _)| !name.starts_with("prior"))
        .collect()
}

#[test]
fn training_affinities_leaves_basis_functions_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), joint()).unwrap();
    let short = ["--set", "train.steps=2", "--set", "train.calibrate=false"];
    train(
        at,
        &[&["--config", "c.toml", "-o", "a"][..], &short].concat(),
    );
    let edges = [
        "--set",
        "train.part=\"affinities\"",
        "--set",
        "train.start=\"a/weights.safetensors\"",
    ];
    train(
        at,
        &[&["--config", "c.toml", "-o", "b"][..], &short, &edges].concat(),
    );
    let [before, after] = ["a", "b"].map(|run| tensors(&at.join(run).join("weights.safetensors")));
    assert!(before.keys().eq(after.keys()));
    let changed: Vec<&String> = before
        .keys()
        .filter(|name| before[*name] != after[*name])
        .collect();
    assert!(changed.len() > 20, "{changed:?}");
    assert!(
        changed.iter().all(|name| name.starts_with("edges.")),
        "{changed:?}"
    );

    std::fs::write(at.join("d.toml"), CONFIG).unwrap();
    let refused = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args(["train", "--config", "d.toml", "-o", "c"])
        .args(["--set", "train.part=\"affinities\""])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&refused.stderr);
    assert!(
        text.contains("needs a network with `affinities` above 0"),
        "{text}"
    );
}

#[test]
fn affinities_learn_the_same_whatever_the_basis_functions() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), CONFIG).unwrap();
    std::fs::write(at.join("d.toml"), joint()).unwrap();
    let run = |config: &str, name: &str, more: &[&str]| {
        let short = ["--config", config, "-o", name, "--set", "train.steps=2"];
        let uncalibrated = ["--set", "train.calibrate=false"];
        train(at, &[&short[..], &uncalibrated, more].concat());
        tensors(&at.join(name).join("weights.safetensors"))
    };
    run("c.toml", "bases", &[]);
    let edges = "train.part=\"affinities\"";
    let start = "train.start=\"bases/weights.safetensors\"";
    let beside = run("d.toml", "beside", &["--set", edges, "--set", start]);
    let alone = run("d.toml", "alone", &["--set", edges]);
    assert!(alone.keys().eq(beside.keys()));
    for (name, values) in &alone {
        let same = *values == beside[name];
        // Gains, biases and statistics of other parts may still have their initial constants.
        let constant = name.contains("norm") || name.contains("bias");
        let expected = name.starts_with("edges.");
        assert!(
            same == expected || (!expected && constant),
            "{name} is the same: {same}"
        );
    }
}

/// Configuration with a teacher, and images without depths as a third of all frames, which it writes.
fn taught(at: &Path) -> String {
    for i in 0..5_u8 {
        let image = image::RgbImage::from_fn(64, 48, |x, y| {
            image::Rgb([(x * 4) as u8, (y * 5) as u8, 50 * i])
        });
        std::fs::create_dir_all(at.join("images")).unwrap();
        image.save(at.join(format!("images/{i}.png"))).unwrap();
    }
    format!(
        "{CONFIG}\n[train.teacher]\nweights = \"small\"\ntarget = \"all\"\npoints = 100\nfolder = \"kept\"\n\
         [[data.more]]\ndataset = \"folder\"\nroot = \"images\"\nshare = 0.3333\n\
         folder = {{ rgb = \"{{frame}}.png\", depth = \"\" }}\n"
    )
}

#[test]
fn nor_do_they_with_a_teacher_and_several_datasets() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = taught(at);
    std::fs::write(at.join("c.toml"), &config).unwrap();
    // Two processes prepare everything that a run needs.
    let prepare = ["--config", "c.toml", "--prepare", "--shard"];
    train(at, &[&prepare[..], &["0/2"]].concat());
    train(at, &[&prepare[..], &["1/2"]].concat());
    let kept = || {
        let files = std::fs::read_dir(at.join("kept")).unwrap();
        let mut files: Vec<_> = files.map(|file| file.unwrap().file_name()).collect();
        files.sort();
        files
    };
    let before = kept();
    // The rooms that are not held out (of 12), and 5 images.
    assert_eq!(before.len(), 15);
    assert!(!at.join("runs").exists());
    let short = ["--set", "train.calibrate=false"];
    train(
        at,
        &[&["--config", "c.toml", "-o", "a"][..], &short].concat(),
    );
    assert_eq!(kept(), before);
    // Prepared again by a run, also by a resumed one.
    std::fs::remove_dir_all(at.join("kept")).unwrap();
    let workers = ["--set", "train.workers=3"];
    train(
        at,
        &[&["--config", "c.toml", "-o", "b"][..], &short, &workers].concat(),
    );
    assert_eq!(losses(at, "a"), losses(at, "b"));
    std::fs::remove_dir_all(at.join("b/checkpoints/00000006")).unwrap();
    train(at, &["--resume", "b"]);
    assert_eq!(losses(at, "a"), losses(at, "b"));
    let [a, b] = ["a", "b"].map(|run| tensors(&at.join(run).join("weights.safetensors")));
    assert!(a == b, "the weights differ");

    // A run does not resume with another teacher.
    let settings = at.join("b/config.toml");
    let text = std::fs::read_to_string(&settings).unwrap();
    let refused = |args: &[&str]| {
        let run = Command::new(env!("CARGO_BIN_EXE_lsdc"))
            .current_dir(at)
            .arg("train")
            .args(args)
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(2));
        String::from_utf8(run.stderr).unwrap()
    };
    let text = text.replace("weights = \"small\"", "weights = \"default\"");
    std::fs::write(&settings, text).unwrap();
    let said = refused(&["--resume", "b"]);
    assert!(said.contains("teacher.weights"), "{said}");

    let alone = config.split("[train.teacher]").next().unwrap().to_owned();
    let images = config.split("[[data.more]]").nth(1).unwrap();
    std::fs::write(at.join("d.toml"), format!("{alone}[[data.more]]{images}")).unwrap();
    let said = refused(&["--config", "d.toml", "-o", "d"]);
    assert!(said.contains("without a teacher"), "{said}");
    let said = refused(&["--config", "d.toml", "--set", "data.more=[]", "--prepare"]);
    assert!(said.contains("nothing is kept"), "{said}");
}

#[test]
fn nor_do_they_beside_the_network_of_a_teacher() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), joint()).unwrap();
    train(
        at,
        &["--config", "c.toml", "-o", "a", "--set", "train.steps=2"],
    );
    let teacher = at.join("a/weights.safetensors");
    let losses = "affinities = 0.1, teacher_affinities = 0.1, teacher_span = 0.1 }";
    let config = joint().replace("affinities = 0.1 }", losses);
    let taught = |weights: &str| format!("{config}[train.teacher]\nweights = {weights:?}\n");
    unchanged(&taught(teacher.to_str().unwrap()));

    std::fs::write(at.join("d.toml"), taught("small")).unwrap();
    let refused = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args(["train", "--config", "d.toml", "-o", "d"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        said.contains("228x304 pixels") && said.contains("48x64"),
        "{said}"
    );
    assert!(!at.join("d").exists());
}

/// Output of `lsdc weights info` on a file.
fn info(at: &Path, file: &str, args: &[&str]) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(at)
        .args(["weights", "info", file])
        .args(args)
        .output()
        .unwrap();
    assert!(run.status.success(), "{file}");
    String::from_utf8(run.stdout).unwrap()
}

fn history(at: &Path, file: &str) -> Vec<serde_json::Value> {
    let info: serde_json::Value = serde_json::from_str(&info(at, file, &["--json"])).unwrap();
    info["history"].as_array().unwrap().clone()
}

#[test]
fn weights_tell_what_they_were_made_from() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("c.toml"), joint()).unwrap();
    let short = ["--config", "c.toml", "--set", "train.steps=2"];
    train(at, &[&short[..], &["-o", "a", "--seed", "7"]].concat());
    let next = [
        "--set",
        "train.start=a/weights.safetensors",
        "--set",
        "train.teacher.weights=a/weights.safetensors",
        "-o",
        "b",
    ];
    train(at, &[&short[..], &next].concat());

    // Frames for calibration, showing a slope.
    std::fs::create_dir_all(at.join("frames/train")).unwrap();
    let depths = (0..64 * 48).map(|i| 1.0 + (i % 64) as f32 / 32.0).collect();
    let depths = lsdc_eval::data::DepthMap::new(64, 48, depths).unwrap();
    for i in 0..4_u8 {
        let image = image::RgbImage::from_fn(64, 48, |x, y| {
            image::Rgb([(x * 4) as u8, (y * 5) as u8, 60 * i])
        });
        let file = |ending: &str| at.join(format!("frames/train/{i}{ending}"));
        image.save(file(".jpg")).unwrap();
        lsdc_eval::data::write_depth_png(&file("_depth.png"), &depths, 0.001).unwrap();
    }
    let run = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lsdc"));
        command.current_dir(at).args(args).assert().success();
    };
    let on = ["calibrate", "--dataset", "folder", "--root", "frames"];
    let from = ["--weights", "b/weights.safetensors", "-o", "c.safetensors"];
    run(&[&on[..], &from].concat());
    let from = ["--weights", "c.safetensors", "-o", "d.safetensors"];
    run(&[&on[..], &["--only-errors"], &from].concat());
    run(&["weights", "convert", "d.safetensors", "e.safetensors"]);

    let made = history(at, "e.safetensors");
    let by: Vec<&str> = made.iter().map(|m| m["by"].as_str().unwrap()).collect();
    let expected = [
        "train",
        "train",
        "calibrate",
        "calibrate --only-errors",
        "weights convert --precision f16",
    ];
    assert_eq!(by, expected);
    // Earlier entries are neither lost nor changed.
    assert_eq!(history(at, "a/weights.safetensors"), made[..1]);
    assert_eq!(history(at, "b/weights.safetensors"), made[..2]);
    assert_eq!(history(at, "d.safetensors"), made[..4]);

    let first = &made[0];
    assert_eq!(first["program"]["version"], env!("CARGO_PKG_VERSION"));
    let train = &first["settings"]["train"];
    assert_eq!((&train["seed"], &train["steps"]), (&7.into(), &2.into()));
    assert_eq!(first["settings"]["network"]["bases"], 24);
    assert_eq!(first["settings"]["fit"]["method"], "joint");
    assert_eq!(first["of"].as_array().unwrap().len(), 0);
    let data: serde_json::Value =
        serde_json::from_slice(&std::fs::read(at.join("a/data.json")).unwrap()).unwrap();
    assert_eq!(first["data"], data);
    let log = std::fs::read_to_string(at.join("a/metrics.jsonl")).unwrap();
    let seconds = log.lines().filter_map(|line| {
        serde_json::from_str::<serde_json::Value>(line).unwrap()["seconds"].as_f64()
    });
    assert_eq!(first["seconds"].as_f64(), Some(seconds.sum()));
    assert_eq!(first["ended"].as_str().unwrap().len(), 20);

    // The weights used, by the bytes of their files, and the history of the teacher.
    let bytes = std::fs::read(at.join("a/weights.safetensors")).unwrap();
    let contents = format!("{:016x}", lsdc_rng::hash(&[bytes]));
    let of = &made[1]["of"];
    for (number, role, history) in [(0, "start", &made[..0]), (1, "teacher", &made[..1])] {
        assert_eq!(of[number]["role"], role);
        assert_eq!(of[number]["weights"], "a/weights.safetensors");
        assert_eq!(of[number]["contents"], contents.as_str());
        assert_eq!(of[number]["history"].as_array().unwrap(), history);
    }
    assert_eq!(made[2]["data"]["frames"], 4);
    assert_eq!(made[2]["of"][0]["weights"], "b/weights.safetensors");
    let text = info(at, "e.safetensors", &[]);
    for words in ["train, lsdc", "seed 7", "teacher: 20", "4 frames of"] {
        assert!(text.contains(words), "`{words}` is missing in: {text}");
    }
}
