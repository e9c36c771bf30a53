//! `lsdc serve` and `lsdc view` as processes.

use super::*;
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Stdio};

/// A server process, and the first line that it printed.
struct Serving {
    child: Option<Child>,
    line: String,
}

impl Serving {
    fn start(folder: &Path, args: &[&str]) -> Self {
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_lsdc"))
            .args(args)
            .current_dir(folder)
            .env("LSDC_WEIGHTS", folder.join("nowhere"))
            .env_remove("LSDC_TOKEN")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let printed = child.stdout.take().unwrap();
        BufReader::new(printed).read_line(&mut line).unwrap();
        Self {
            child: Some(child),
            line: line.trim().to_owned(),
        }
    }

    /// The printed address.
    fn address(&self) -> &str {
        self.line.split_whitespace().last().unwrap()
    }

    /// Terminates the process with a signal, and returns its exit code and log.
    #[cfg(unix)]
    fn end(mut self) -> (Option<i32>, String) {
        let child = self.child.take().unwrap();
        let pid = child.id().to_string();
        let kill = std::process::Command::new("kill").arg(pid).status();
        assert!(kill.unwrap().success());
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), said)
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The `curl` commands of the page on the service.
fn lines() -> Vec<String> {
    let chapter = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/serve.md");
    let chapter = std::fs::read_to_string(chapter).unwrap();
    let blocks = chapter.split("```sh\n").skip(1);
    let lines = blocks.flat_map(|block| block.split("```").next().unwrap().lines());
    let lines = lines.filter(|line| line.contains("$LSDC"));
    lines.map(str::to_owned).collect()
}

#[cfg(unix)]
#[test]
#[allow(clippy::print_stderr)]
fn the_lines_for_curl_work() {
    let curl = std::process::Command::new("curl").arg("--version").output();
    if curl.is_err() {
        eprintln!("there is no curl here");
        return;
    }
    let folder = room();
    let service = Serving::start(folder.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let lines = lines();
    assert!(lines.len() >= 12, "{}", lines.len());
    // In one shell, because a variable holds the name of the scene.
    let script = format!("set -ex\n{}", lines.join("\n"));
    let run = Command::new("sh")
        .args(["-c", &script])
        .current_dir(folder.path())
        .env("LSDC", service.address())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{said}");

    // The files equal those of `lsdc complete`.
    let args = ["complete", "rgb.png", "sparse.npy", "--uncertainty", "-o"];
    for (got, own) in [("depth.png", "own.png"), ("depth.exr", "own.exr")] {
        lsdc(folder.path()).args(args).arg(own).assert().success();
        let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
        assert!(read(got) == read(own), "{got}");
    }
    let cloud = std::fs::read(folder.path().join("cloud.ply")).unwrap();
    assert!(cloud.starts_with(b"ply\n"));

    let (code, log) = service.end();
    assert_eq!(code, Some(0), "{log}");
    let entries = log.lines().filter(|line| line.starts_with('{'));
    assert_eq!(entries.count(), lines.len(), "{log}");
}

/// The report equals that of `lsdc complete`, except times and entries on files.
#[test]
fn the_report_is_that_of_the_program() {
    let folder = room();
    let run = lsdc(folder.path())
        .args([
            "complete",
            "rgb.png",
            "sparse.npy",
            "--json",
            "--formats",
            "npy",
        ])
        .output()
        .unwrap();
    let mut own: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let service = Serving::start(folder.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let Ok(curl) = std::process::Command::new("curl")
        .args(["-sS", "-F", "image=@rgb.png", "-F", "points=@sparse.npy"])
        .arg(format!("{}/v1/complete", service.address()))
        .current_dir(folder.path())
        .output()
    else {
        return;
    };
    let mut found: serde_json::Value = serde_json::from_slice(&curl.stdout).unwrap();
    for key in ["image", "status", "seconds", "remarks", "outputs"] {
        own.as_object_mut().unwrap().remove(key);
        found.as_object_mut().unwrap().remove(key);
    }
    assert_eq!(found, own);
}

#[test]
fn other_machines_are_not_served_by_mistake() {
    let folder = room();
    let listen = ["serve", "--listen", "0.0.0.0:0"];
    refused(folder.path(), &listen, &["no token", "--without-token"]);
    std::fs::write(folder.path().join("token"), "short\n").unwrap();
    let short = [&listen[..], &["--token-file", "token"]].concat();
    failed(lsdc(folder.path()).args(short), 2, &["less than 16"]);
    let both = [&listen[..], &["--token-file", "token", "--without-token"]].concat();
    failed(lsdc(folder.path()).args(both), 2, &["cannot be used with"]);
    let tls = ["serve", "--tls-cert", "token", "--tls-key", "token"];
    failed(
        lsdc(folder.path()).args(tls),
        2,
        &["cannot be used for HTTPS"],
    );
}

#[cfg(unix)]
#[test]
fn the_page_is_served_to_who_has_its_link() {
    let folder = room();
    let args = ["view", "rgb.png", "sparse.npy", "--no-browser"];
    let page = Serving::start(folder.path(), &args);
    assert!(
        page.line.starts_with("page      http://127.0.0.1:"),
        "{}",
        page.line
    );
    let (base, token) = page.address().split_once("/?token=").unwrap();
    assert_eq!(token.len(), 32);
    let get = |args: &[&str]| {
        let mut curl = std::process::Command::new("curl");
        let output = curl
            .args(["-sS", "-o", "out", "-w", "%{http_code}"])
            .args(args);
        let output = output.current_dir(folder.path()).output().ok()?;
        Some(String::from_utf8(output.stdout).unwrap())
    };
    if let Some(status) = get(&[base]) {
        assert_eq!(status, "401");
        let jar = ["-L", "-c", "jar", "-b", "jar"];
        assert_eq!(get(&[&jar[..], &[page.address()]].concat()).unwrap(), "200");
        let html = std::fs::read_to_string(folder.path().join("out")).unwrap();
        assert!(html.contains("<title>"), "{html}");
        let start = format!("{base}/v1/start/points.npy");
        assert_eq!(get(&["-b", "jar", &start]).unwrap(), "200");
        let points = std::fs::read(folder.path().join("out")).unwrap();
        assert!(points == std::fs::read(asset("sparse.npy")).unwrap());
    }
    assert_eq!(page.end().0, Some(0));
}

#[test]
fn the_page_is_not_opened_with_what_is_not_there() {
    let folder = room();
    refused(folder.path(), &["view", "none.png"], &["none.png"]);
    refused(
        folder.path(),
        &["view", "--gallery", "none"],
        &["no folder"],
    );
}
