//! A recording whose depths go into another recording.

use super::calibration::Calibration;
use super::failures::Failures;
use super::flow::{self, finished};
use super::frame::{Completed, Engine};
use super::loaded::Loaded;
use super::outputs::{FormatData, cloud};
use super::recorded::Recorded;
use super::settings::Settings;
use super::summary::Summary;
use super::tally::Tally;
use super::views::RecordedViews;
use crate::cli::args::Complete;
use crate::cli::{Exit, ui};
use lsdc_eval::data::{self, Shard};
use lsdc_eval::predict::GuideSpec;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_recordings::{
    Header, MessageLocation, MessageTimes, MessageType, Recording, SyncedFrame, Writer,
    write_cloud, write_depth,
};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};

/// Topics of results.
const DEPTH: &str = "/lsdc/depth";
const SIGMA: &str = "/lsdc/sigma";
const POINTS: &str = "/lsdc/points";

/// Frames that wait to be written.
const WAITING: usize = 2;

/// The messages of a frame, and where its image is in the recording that it is from.
struct Done {
    location: MessageLocation,
    times: MessageTimes,
    messages: Messages,
}

/// Topics, types and contents.
type Messages = Vec<(&'static str, MessageType, Vec<u8>)>;

pub(super) fn run(args: &Complete, output: &Path) -> Result<Exit> {
    check(args, output)?;
    let settings = &Settings::of_recording(args.clone(), output)?;
    let recorded = Arc::new(Recorded::open(settings)?);
    let source = if settings.recording.copy {
        let source = Recording::open(&settings.sparse)?;
        check_names(&source)?;
        Some(source)
    } else {
        None
    };
    recorded.tell(settings.json);
    let views = RecordedViews::open(settings, recorded.clone())?;
    let engine = Engine::new(settings, settings.json)?;
    let bag = Writer::create(output)?;
    let stop = ui::stop_flag();
    let frames: Vec<(PathBuf, &SyncedFrame)> = recorded
        .frames()
        .iter()
        .map(|frame| (Recorded::name(frame), frame))
        .collect();
    let bar = ui::bar(frames.len(), "frames");
    let failures = Failures::new(settings.json).beside(&bar);
    let mut tally = Tally::new(&bar, settings.json);
    let mut calibration = Calibration::new(settings);
    let (mut lost, mut broken) = (0, false);

    let bag = std::thread::scope(|scope| {
        let (send, done) = sync_channel(WAITING);
        let stopped = &stop;
        let writer = scope.spawn(move || write(bag, &done, source, stopped));
        let flown = flow::run(
            &frames,
            &engine,
            (&failures, &stop),
            |(name, _)| name,
            |(_, frame)| {
                let (header, mut loaded) = recorded.load(frame)?;
                loaded.views = views.as_ref().and_then(|views| views.find(frame));
                Ok((header, loaded.with_options(settings)?))
            },
            |_, loaded, prepared| prepared.fit(&loaded.points, None, loaded.views.as_ref()),
            |(name, frame), header, loaded, completed| {
                let (format_data, messages, beyond) =
                    messages(settings, &header, loaded, completed)?;
                let done = Done {
                    location: frame.location,
                    times: frame.times,
                    messages,
                };
                if send.send(done).is_err() {
                    // Why is said below, once.
                    broken = true;
                    stop.store(true, Ordering::Relaxed);
                    return Ok(());
                }
                lost += beyond;
                tally.add(name, &Summary::new(name, loaded, completed, &format_data));
                for warning in calibration.add(loaded, completed, Some((&recorded, frame))) {
                    tally.warn(&warning);
                }
                Ok(())
            },
        );
        drop(send);
        let bag = finished(writer)?;
        flown.map(|()| bag)
    })?;
    bar.finish_and_clear();
    if !broken && stop.load(Ordering::Relaxed) {
        ui::say("hint: nothing is written; give -o DIR for results that a later run goes on with");
        return Ok(Exit::Interrupted);
    }
    let (bag, failed) = (bag?, failures.count());
    if bag.undefined() > 0 {
        ui::warn(&format!(
            "warning: {} topics are copied whose recording does not say what their messages are made of",
            bag.undefined()
        ));
    }
    bag.finish()?;
    tally.print_totals(0, failed);
    let tell = if settings.json { ui::say } else { ui::tell };
    if lost > 0 {
        tell(&format!(
            "16UC1     {lost} pixels beyond 65.535 m hold no depth; give --units m"
        ));
    }
    tell(&format!("written   {}", output.display()));
    Ok(if failed > 0 {
        Exit::Partial
    } else {
        Exit::Done
    })
}

/// Checks that what is asked for goes into a recording.
fn check(args: &Complete, output: &Path) -> Result<()> {
    let alien = [
        ("`--formats`", args.formats.is_some()),
        ("`--export`", !args.export.is_empty()),
        ("`--range`", args.range.is_some()),
        ("`--outliers`", args.outliers),
        ("`--temporal`", args.temporal),
        ("`--sigma`", args.sigma.is_some()),
        (
            "`--guide FILE`",
            matches!(args.guide, Some(GuideSpec::Files(_))),
        ),
        ("`--shard`", args.shard != Shard::WHOLE),
    ];
    if let Some((option, _)) = alien.into_iter().find(|(_, given)| *given) {
        let what = format!("{option} is not for results in a recording");
        return Err(Error::config(what).hint("leave it out, or give -o DIR"));
    }
    if let Some(option) = args.of_clouds().filter(|_| !args.recorded.cloud) {
        return Err(Error::config(format!("`{option}` is for clouds")).hint("give --cloud"));
    }
    let real = |path: &Path| path.canonicalize().ok();
    if output.exists() && real(output) == real(&args.sparse) {
        let what = format!("`{}` is the recording", output.display());
        return Err(Error::config(what).hint("give another file with -o"));
    }
    let folder = output
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    data::check_output(output, args.force)?;
    data::remove_leftovers(folder);
    Ok(())
}

/// Checks that no topic that is copied is called as one of the results.
fn check_names(source: &Recording) -> Result<()> {
    let topics = source.topics();
    let taken = topics
        .iter()
        .find(|topic| [DEPTH, SIGMA, POINTS].contains(&topic.name.as_str()));
    match taken {
        Some(topic) => {
            let what = format!("the recording has a topic `{}` already", topic.name);
            Err(Error::config(what)
                .hint("leave --copy out, or complete the recording that it was made from"))
        }
        None => Ok(()),
    }
}

/// The messages of a frame, and how many depths are too far for them.
fn messages(
    settings: &Settings,
    header: &Header,
    loaded: &Loaded,
    completed: &Completed,
) -> Result<(FormatData, Messages, usize)> {
    let millimetres = settings.recording.units.is_millimetres();
    let deviations = completed.deviations();
    let (depth, lost) = write_depth(header, &completed.depth, millimetres);
    let mut messages = vec![(DEPTH, MessageType::Image, depth)];
    if let Some(sigma) = deviations.filter(|_| settings.uncertainty) {
        messages.push((
            SIGMA,
            MessageType::Image,
            write_depth(header, sigma, false).0,
        ));
    }
    let mut format_data = FormatData::default();
    if settings.recording.cloud {
        let camera = loaded.camera.as_ref().ok_or_else(|| {
            Error::config("`--cloud` needs the camera of the images")
                .hint("name it by --camera-info")
        })?;
        let cloud = cloud(settings, loaded, completed, camera);
        messages.push((
            POINTS,
            MessageType::PointCloud2,
            write_cloud(header, &cloud.points),
        ));
        format_data.cloud = Some(cloud);
    }
    Ok((format_data, messages, lost))
}

/// Writes frames as they come, each behind its image, if the recording that they are from is copied.
fn write(
    mut bag: Writer,
    done: &Receiver<Done>,
    source: Option<Recording>,
    stop: &AtomicBool,
) -> Result<Writer> {
    let put = |bag: &mut Writer, done: Done| {
        let mut messages = done.messages.iter();
        messages.try_for_each(|(topic, kind, data)| bag.write(topic, *kind, done.times, data))
    };
    let Some(mut source) = source else {
        done.iter().try_for_each(|done| put(&mut bag, done))?;
        return Ok(bag);
    };
    let mut next = done.recv().ok();
    source.visit(&|_| true, &mut |topic, message| {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::new(Cause::Write, "the program was stopped"));
        }
        bag.copy(topic, message)?;
        while let Some(frame) = next.take_if(|next| next.location <= message.location) {
            put(&mut bag, frame)?;
            next = done.recv().ok();
        }
        Ok(())
    })?;
    if next.is_some() {
        return Err(Error::new(
            Cause::Read,
            "the recording has changed while it was read",
        ));
    }
    Ok(bag)
}
