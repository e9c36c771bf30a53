//! Lists the files of the page, which become part of the library.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=page/dist");
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("page/dist");
    let mut files = Vec::new();
    collect(&root, &mut files)?;
    files.sort();
    let mut code = "static FILES: &[(&str, &[u8])] = &[
"
    .to_owned();
    for file in files {
        let name = file
            .strip_prefix(&root)?
            .to_string_lossy()
            .replace('\\', "/");
        let file = file.to_string_lossy();
        writeln!(code, "    ({name:?}, include_bytes!({file:?})),")?;
    }
    code.push_str(
        "];
",
    );
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("page.rs"), code)?;
    Ok(())
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}
