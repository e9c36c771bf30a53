//! The help of every command, as files in `help/`. `LSDC_UPDATE_HELP=1` rewrites them.

use crate::lsdc;
use std::path::Path;

/// Every command and its subcommands.
fn commands(folder: &Path) -> Vec<Vec<String>> {
    let below = |command: &[String]| -> Vec<Vec<String>> {
        let help = help(folder, command, "-h");
        let list = help.lines().skip_while(|line| *line != "Commands:").skip(1);
        list.take_while(|line| !line.is_empty())
            // Longer descriptions continue in lines with more indentation.
            .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
            .filter(|name| !name.is_empty() && *name != "help")
            .map(|name| [command, &[name.to_owned()]].concat())
            .collect()
    };
    let mut all = vec![vec![]];
    let mut done = 0;
    while done < all.len() {
        let more = below(&all[done]);
        all.extend(more);
        done += 1;
    }
    all
}

fn help(folder: &Path, command: &[String], flag: &str) -> String {
    let run = lsdc(folder).args(command).arg(flag).assert().success();
    String::from_utf8(run.get_output().stdout.clone()).unwrap()
}

#[test]
fn help_of_every_command_is_as_reviewed() {
    let folder = tempfile::tempdir().unwrap();
    let reviewed = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/help");
    let update = std::env::var_os("LSDC_UPDATE_HELP").is_some();
    let mut expected = 0;
    for command in commands(folder.path()) {
        let name = [&["lsdc".to_owned()], command.as_slice()]
            .concat()
            .join("-");
        let path = reviewed.join(name).with_extension("txt");
        let found = help(folder.path(), &command, "--help");
        if update {
            std::fs::write(&path, &found).unwrap();
        }
        let stored = std::fs::read_to_string(&path)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert_eq!(
            found,
            stored,
            "LSDC_UPDATE_HELP=1 writes {}",
            path.display()
        );
        expected += 1;
    }
    let files = std::fs::read_dir(&reviewed).unwrap().count();
    assert_eq!(files, expected, "files of commands that are gone");
}
