//! `lsdc weights add` and `lsdc weights get`: what weights of the program are built on, from a file or its publisher.

use super::args::Add;
#[cfg(feature = "download")]
use super::args::Get;
use super::ui;
#[cfg(feature = "download")]
use lsdc_files::error::Error;
use lsdc_files::error::Result;
use lsdc_weights::{Added, KNOWN, Known, Store};
#[cfg(feature = "download")]
use lsdc_weights::{Event, Limits, get as download};

pub(super) fn add(args: &Add) -> Result<()> {
    let store = Store::open()?;
    let (known, added) = store.add(&args.file, &KNOWN, args.force)?;
    say(&store, known, added);
    Ok(())
}

#[cfg(feature = "download")]
pub(super) fn get(args: &Get) -> Result<()> {
    let known = KNOWN.iter().find(|known| known.weights == args.name);
    let known = known.ok_or_else(|| Error::config(format!("no weights `{}`", args.name)))?;
    let places = match &args.url {
        Some(url) => &[url.as_str()][..],
        None => known.places,
    };
    let store = Store::open()?;
    let (mut bar, mut named) = (None, false);
    let mut tell = |event: Event<'_>| match event {
        Event::Begun {
            place,
            before,
            total,
        } => {
            if !std::mem::replace(&mut named, true) {
                ui::say(&format!("{}, licence {}", known.name, known.licence));
            }
            let goes_on = match before {
                0 => String::new(),
                bytes => format!(", going on after {:.1} MB", bytes as f64 / 1e6),
            };
            ui::say(&format!("from {place}{goes_on}"));
            let begun = bar.insert(ui::byte_bar(total));
            begun.set_position(before);
            // What was there before says nothing about the speed.
            begun.reset_eta();
        }
        Event::Reached(bytes) => {
            if let Some(bar) = &bar {
                bar.set_position(bytes);
            }
        }
        Event::Broken(error) | Event::Elsewhere(error) => {
            bar = None;
            ui::say(&error.with_causes());
        }
    };
    let added = download(
        &store,
        known,
        places,
        args.force,
        &Limits::default(),
        &mut tell,
    );
    drop(bar);
    say(&store, known, added?);
    Ok(())
}

fn say(store: &Store, known: &Known, added: Added) {
    let path = store.path(known);
    let path = path.display();
    let Known {
        weights,
        name,
        licence,
        ..
    } = known;
    match added {
        Added::New => ui::tell(&format!(
            "installed {name}, licence {licence}, for the weights `{weights}`: {path}"
        )),
        Added::Before => ui::tell(&format!("unchanged {name} is installed: {path}")),
    }
}
