//! `lsdc weights`.

use super::*;
use lsdc_eval::metrics::{Metric, Rules, Scores};
use lsdc_weights::{Precision, open_weights, to_bytes};

#[test]
fn weights_are_listed_described_and_converted() {
    let folder = room();
    let at = folder.path();
    let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
    assert!(list.starts_with("default "), "{list}");
    let info = lsdc(at)
        .args(["weights", "info", "--json"])
        .output()
        .unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(info["parameters"].as_u64().unwrap() > 100_000, "{info}");
    assert!(info["training"]["steps"].as_u64().unwrap() > 0, "{info}");

    let convert = [
        "weights",
        "convert",
        "default",
        "wide.safetensors",
        "--precision",
        "f32",
    ];
    lsdc(at).args(convert).assert().success();
    refused(at, &convert, &["exists", "--force"]);
    // Wider floats hold the same numbers.
    for (weights, output) in [("default", "a"), ("wide.safetensors", "b")] {
        let complete = [
            "complete",
            "rgb.png",
            "sparse.npy",
            "--weights",
            weights,
            "-o",
            output,
        ];
        lsdc(at).args(complete).assert().success();
    }
    let depth = |folder: &str| read_npy(&at.join(folder).join("rgb_depth.npy"), 1.0).unwrap();
    assert_eq!(depth("a"), depth("b"));
    refused(at, &["weights", "info", "nothing"], &["nothing", "default"]);
}

#[test]
fn networks_are_exported_as_onnx() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let export = ["weights", "export", "small", "--onnx", "small.onnx"];
    let printed = text(&lsdc(at).args(export).assert().success());
    assert!(printed.starts_with("written   small.onnx, "), "{printed}");
    let weights = open_weights(Some(Path::new("small"))).unwrap();
    let bytes = std::fs::read(at.join("small.onnx")).unwrap();
    assert_eq!(
        bytes,
        lsdc_weights::to_onnx(
            &weights,
            &lsdc_weights::weights_name(Some(Path::new("small"))).unwrap()
        )
        .unwrap()
    );
    refused(at, &export, &["exists", "--force"]);
    let anything = ["weights", "export", "anything", "--onnx", "a.onnx"];
    refused(at, &anything, &["pretrained encoder", "`default`"]);
    assert!(!at.join("a.onnx").exists());
}

#[test]
fn all_weights_of_the_program_are_better_than_none() {
    let folder = room();
    let at = folder.path();
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let rmse = |with: &[&str], output: &str| {
        lsdc(at)
            .args(["complete", "rgb.png", "sparse.npy", "-o", output])
            .args(with)
            .assert()
            .success();
        let depth = read_npy(&at.join(output).join("rgb_depth.npy"), 1.0).unwrap();
        let scores = Scores::of(&depth, &truth, &Rules::default()).unwrap();
        scores[Metric::Rmse]
    };
    let linear = rmse(&["--method", "linear"], "linear");
    let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
    let built_in = list.lines().filter(|line| line.contains("built in"));
    let names: Vec<&str> = built_in.filter_map(|l| l.split(' ').next()).collect();
    assert_eq!(names, ["default", "small"]);
    for name in names {
        let error = rmse(&["--weights", name], name);
        assert!(error < 0.9 * linear, "{name}: {error} m, linear {linear} m");
    }
}

#[test]
fn licences_of_training_data_are_stated() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
    let below = |name: &str| {
        let lines = list.lines().skip_while(|line| !line.starts_with(name));
        lines.skip(1).collect::<Vec<_>>()
    };
    assert!(
        below("default ")[0].starts_with(
            "          trained on non-commercial data: RGB-D-D, Replica, GQ-CNN examples, SUN database, \
             BSDS500, ImageNet samples, KITTI (calibration only), nuScenes (calibration only); data without a \
             clear licence: NYU Depth v2, "
        ),
        "{list}"
    );
    let [anything, head] = below("anything ")[..] else {
        panic!("{list}");
    };
    assert!(
        anything.starts_with(
            "          the weights, MIT OR Apache-2.0, trained on non-commercial data: RGB-D-D, Replica, \
             GQ-CNN examples, KITTI (calibration only); data without a clear licence: NYU Depth v2, "
        ),
        "{list}"
    );
    assert!(
        head.starts_with("          the learned tensor of the depth head, MIT OR Apache-2.0, ")
    );

    let convert = ["weights", "convert", "default", "own.safetensors"];
    lsdc(at).args(convert).assert().success();
    let info = |args: &[&str]| {
        let info = lsdc(at).args(["weights", "info"]).args(args).assert();
        text(&info.success())
    };
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_str(&info(&[name, "--json"])).unwrap()
    };
    let (default, own) = (json("default"), json("own.safetensors"));
    assert_eq!(default["licence"], "Apache-2.0");
    let sets = default["trained_on"].as_array().unwrap();
    assert_eq!(sets.len(), 23);
    assert_eq!(sets[0]["name"], "RGB-D-D");
    assert_eq!(sets[0]["commercial_use"], "no");
    assert_eq!(sets[6]["licence"], "CC BY-NC-SA 3.0");
    assert_eq!(sets[6]["calibration_only"], true);
    // Weights derived from these have the same training data.
    assert_eq!(own["licence"], serde_json::Value::Null);
    assert_eq!(own["trained_on"], default["trained_on"]);

    let (default, own) = (info(&[]), info(&["own.safetensors"]));
    assert!(default.contains("\nlicence    Apache-2.0\n"), "{default}");
    assert!(own.contains("\nlicence    not stated\n"), "{own}");
    for info in [default, own] {
        let words =
            "\ndata       TUM RGB-D (Sturm et al. 2012), licence: CC BY 4.0, commercial use: yes\n";
        assert!(info.contains(words), "{info}");
    }

    // A file may have no notes on its origin.
    let mut weights = open_weights(Some(at.join("own.safetensors").as_ref())).unwrap();
    weights.notes.clear();
    let bytes = to_bytes(&weights, Precision::Half).unwrap();
    std::fs::write(at.join("other.safetensors"), bytes).unwrap();
    let other = info(&["other.safetensors"]);
    let words = "\nlicence    not stated\ndata       not recorded\n";
    assert!(other.contains(words), "{other}");
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name)
}

#[test]
fn weights_that_can_be_installed_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let list = lsdc(at).args(["weights", "list"]).assert().success();
    let (table, said) = (text(&list), list.get_output().stderr.clone());
    let line = table.lines().find(|line| line.starts_with("anything "));
    for words in [
        "44.1 MB",
        "Apache-2.0",
        "not installed",
        "0.12 to 0.25 s more per image",
    ] {
        assert!(line.unwrap().contains(words), "{table}");
    }
    let said = String::from_utf8(said).unwrap();
    assert!(said.contains("`lsdc weights add FILE`"), "{said}");

    let print = ["weights", "list", "--print-folder"];
    let printed = |command: &mut Command| text(&command.args(print).assert().success());
    let folder = printed(&mut lsdc(at));
    assert_eq!(Path::new(folder.trim_end()), at.join("nowhere"));
    #[cfg(unix)]
    {
        let mut unset = lsdc(at);
        unset.env_remove("LSDC_WEIGHTS").env("XDG_DATA_HOME", at);
        assert_eq!(
            Path::new(printed(&mut unset).trim_end()),
            at.join("lsdc/weights")
        );
        let mut home = lsdc(at);
        home.env("LSDC_WEIGHTS", "")
            .env("HOME", at)
            .env_remove("XDG_DATA_HOME");
        let folder = at.join(".local/share/lsdc/weights");
        assert_eq!(Path::new(printed(&mut home).trim_end()), folder);
    }
    assert_eq!(names(at), [""; 0]);
}

#[test]
fn weights_on_an_encoder_that_is_missing_say_what_to_do() {
    let folder = room();
    let at = folder.path();
    let complete = ["complete", "rgb.png", "sparse.npy", "--weights", "anything"];
    let words = [
        "Depth Anything V2 Small",
        "99 MB",
        "Apache-2.0",
        "lsdc weights get anything",
        "lsdc weights add FILE",
    ];
    refused(at, &complete, &words);
    // The program describes its own part without the file.
    let mut info = lsdc(at);
    let info = info.args(["weights", "info", "anything", "--json"]);
    let info = info.output().unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(
        info["network"]["extractor"]["encoder"].as_u64().unwrap() > 0,
        "{info}"
    );
    assert!(info["parameters"].as_u64().unwrap() < 4_000_000, "{info}");
}

#[test]
fn files_of_other_networks_are_not_installed() {
    let folder = room();
    let at = folder.path();
    let tiny = golden("encoder.pth");
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/core/weights/small.safetensors");
    for (file, words) in [
        (&tiny, "is not the encoder of Depth Anything V2 Small"),
        (&own, "no encoder in the form of DINOv2"),
        (
            &at.join("rgb.png"),
            "neither a PyTorch nor a safetensors file",
        ),
        (&at.join("nothing.pth"), "nothing.pth"),
    ] {
        refused(at, &["weights", "add", file.to_str().unwrap()], &[words]);
    }
}

/// `lsdc weights get`, from servers on this machine.
#[cfg(feature = "download")]
mod download {
    use super::super::loopback::{Answer, Server, answer, length};
    use super::*;

    fn get(at: &Path, url: &str) -> Command {
        let mut command = lsdc(at);
        command.args(["weights", "get", "anything", "--url", url]);
        command
    }

    /// An answer that ends after half of the file.
    fn half() -> Answer {
        let headers = [length(200_000), "ETag: \"a\"".to_owned()];
        answer("200 OK", &headers, &vec![7; 100_000])
    }

    /// Lengths of the partial files.
    fn parts(at: &Path) -> Vec<u64> {
        let files = names(&at.join("nowhere")).into_iter();
        let paths = files.map(|name| at.join("nowhere").join(name));
        let parts = paths.filter(|path| path.extension().is_some_and(|e| e == "part"));
        parts.map(|path| path.metadata().unwrap().len()).collect()
    }

    #[test]
    fn what_servers_do_wrong_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let tiny = std::fs::read(golden("encoder.safetensors")).unwrap();
        let moved = || answer("301 Moved", &[length(0), "Location: /".to_owned()], b"");
        let cases: Vec<(Vec<Answer>, i32, &[&str])> = vec![
            (
                vec![answer("404 Not Found", &[length(0)], b"")],
                1,
                &[
                    "404 Not Found",
                    "http://127.0.0.1",
                    "`lsdc weights add FILE`",
                ],
            ),
            (vec![], 1, &["cannot reach `http://127.0.0.1"]),
            (
                vec![moved(), answer("200 OK", &[], b"<html>")],
                2,
                &["is not Depth Anything V2 Small", "caused by"],
            ),
            (
                vec![answer("200 OK", &[length(tiny.len())], &tiny)],
                2,
                &["is not Depth Anything V2 Small", "instead of 384"],
            ),
            (
                vec![answer("200 OK", &[length(1 << 40)], b"")],
                1,
                &["too much for an encoder"],
            ),
        ];
        for (answers, code, words) in cases {
            let server = Server::start(answers);
            failed(&mut get(at, &server.url()), code, words);
            assert_eq!(names(&at.join("nowhere")), [""; 0], "{words:?}");
        }
        refused(
            at,
            &["weights", "get", "default"],
            &["'default'", "anything"],
        );
    }

    #[test]
    fn the_next_run_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let busy = || answer("503 Service Unavailable", &[length(0)], b"");
        let server = Server::start(vec![half(), busy(), busy()]);
        let words = ["503", "0.1 MB are kept"];
        failed(&mut get(at, &server.url()), 1, &words);
        assert_eq!(parts(at), [100_000]);
        failed(&mut get(at, &server.url()), 1, &words);
        let request = server.requests().pop().unwrap();
        assert!(request.contains("range: bytes=100000-"), "{request}");
    }

    /// A limit on file size simulates a full disk.
    #[cfg(unix)]
    #[test]
    fn a_full_disk_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let server = Server::start(vec![half()]);
        let script = "trap '' XFSZ; ulimit -f 160; exec \"$0\" weights get anything --url \"$1\"";
        let mut command = Command::new("sh");
        command
            .args(["-c", script, env!("CARGO_BIN_EXE_lsdc"), &server.url()])
            .env("LSDC_WEIGHTS", at.join("nowhere"));
        failed(&mut command, 1, &["cannot write", ".part", "are kept"]);
        // 160 blocks of 512 bytes.
        assert_eq!(parts(at), [81_920]);
    }

    /// Runs only with `LSDC_ENCODER=FILE`, one of the published files.
    #[allow(clippy::print_stderr)]
    #[test]
    fn the_published_file_is_installed() {
        use lsdc_weights::{ANYTHING, Store};
        let Some(file) = std::env::var_os("LSDC_ENCODER") else {
            eprintln!("not tested: LSDC_ENCODER names no file");
            return;
        };
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let bytes = std::fs::read(&file).unwrap();
        let (all, middle) = (bytes.len(), bytes.len() / 3);
        let tag = || "ETag: \"a\"".to_owned();
        let range = format!("Content-Range: bytes {middle}-{}/{all}", all - 1);
        let server = Server::start(vec![
            answer("200 OK", &[length(all), tag()], &bytes[..middle]),
            answer(
                "206 Partial Content",
                &[length(all - middle), tag(), range],
                &bytes[middle..],
            ),
        ]);
        let said = text(&get(at, &server.url()).assert().success());
        assert!(
            said.starts_with("installed Depth Anything V2 Small"),
            "{said}"
        );
        let store = Store::at(at.join("nowhere"));
        // The depth head as well, if the file has one.
        let names = names(store.folder());
        assert_eq!(names[0], "anything-encoder.safetensors");
        assert_eq!(names.len(), 1 + usize::from(store.has_head(&ANYTHING)));
        assert_eq!(store.load(&ANYTHING).unwrap().len(), 174);
        let add = lsdc(at).args(["weights", "add"]).arg(&file).assert();
        assert!(text(&add.success()).starts_with("unchanged "));
        let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
        assert!(list.contains(" installed "), "{list}");
    }
}
