//! `lsdc weights add` and `lsdc weights get`: what weights of the program are built on, from a file or its publisher.

use super::args::Add;
#[cfg(feature = "download")]
use super::args::Get;
use super::ui;
#[cfg(feature = "download")]
use lsdc_files::error::Error;
use lsdc_files::error::Result;
#[cfg(feature = "download")]
use lsdc_weights::{DownloadEvent, DownloadLimits, get as download};
use lsdc_weights::{Installation, KNOWN, KnownEncoder, Store};

/// Notice that an encoder is installed without the depth head.
pub(super) const NO_HEAD: &str = "its depth head, which `--guide depth-anything` needs, is not installed; \
                                  `lsdc weights add FILE` adds that of the published file";

/// Notice that weights use an encoder without its depth head.
pub(super) const UNGUIDED: &str = "notice: without the depth head of their encoder, these weights are somewhat less accurate; \
                                   `lsdc weights get anything` or `lsdc weights add FILE` brings it";

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
        None => known.urls,
    };
    let store = Store::open()?;
    let (mut bar, mut named) = (None, false);
    let mut tell = |event: DownloadEvent<'_>| match event {
        DownloadEvent::Started {
            url,
            resumed_bytes,
            total_bytes,
        } => {
            if !std::mem::replace(&mut named, true) {
                ui::say(&format!("{}, licence {}", known.name, known.licence));
            }
            let goes_on = match resumed_bytes {
                0 => String::new(),
                bytes => format!(", going on after {:.1} MB", bytes as f64 / 1e6),
            };
            ui::say(&format!("from {url}{goes_on}"));
            let begun = bar.insert(ui::byte_bar(total_bytes));
            begun.set_position(resumed_bytes);
            // Bytes present before the start do not count for the speed.
            begun.reset_eta();
        }
        DownloadEvent::Progress(bytes) => {
            if let Some(bar) = &bar {
                bar.set_position(bytes);
            }
        }
        DownloadEvent::Interrupted(error) | DownloadEvent::NextUrl(error) => {
            bar = None;
            ui::say(&error.with_causes());
        }
    };
    let added = download(
        &store,
        known,
        places,
        args.force,
        &DownloadLimits::default(),
        &mut tell,
    );
    drop(bar);
    say(&store, known, added?);
    Ok(())
}

fn say(store: &Store, known: &KnownEncoder, added: Installation) {
    let path = store.path(known);
    let path = path.display();
    let KnownEncoder {
        weights,
        name,
        licence,
        ..
    } = known;
    match added {
        Installation::New => ui::tell(&format!(
            "installed {name}, licence {licence}, for the weights `{weights}`: {path}"
        )),
        Installation::Head => ui::tell(&format!(
            "installed the depth head of {name}, licence {licence}: {}",
            store.head_path(known).display()
        )),
        Installation::Unchanged => ui::tell(&format!("unchanged {name} is installed: {path}")),
    }
    if !store.has_head(known) {
        ui::say(NO_HEAD);
    }
}
