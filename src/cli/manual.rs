//! `lsdc completions` and `lsdc man`: the command line as other programs read it.

use super::args::{Args, Completions, Manual};
use super::{Exit, ui};
use clap::CommandFactory as _;
use clap_mangen::Man;
use lsdc_eval::data::write_atomically;
use lsdc_files::error::{Error, Result};

pub(super) fn completions(args: &Completions) -> Exit {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "lsdc", &mut script);
    ui::print(&String::from_utf8_lossy(&script));
    Exit::Done
}

/// Pages for the program and each of its commands, `lsdc.1`, `lsdc-complete.1` and so on.
pub(super) fn man(args: &Manual) -> Result<Exit> {
    let folder = &args.output;
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    let mut left = vec![Args::command().disable_help_subcommand(true)];
    if let Some(program) = left.first_mut() {
        program.build();
    }
    while let Some(command) = left.pop() {
        left.extend(command.get_subcommands().cloned());
        let page = Man::new(command);
        write_atomically(&folder.join(page.get_filename()), |mut out| {
            page.render(&mut out)
        })?;
    }
    ui::tell(&format!("written   {}", folder.display()));
    Ok(Exit::Done)
}
