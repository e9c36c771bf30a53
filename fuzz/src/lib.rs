//! Helper functions of the targets.

#[cfg(feature = "evaluation")]
use lsdc_eval::data::{DataConfig, DatasetKind, Split};
use lsdc_recordings::{FrameOptions, Frames, Recording, Survey};
use std::path::Path;
use std::sync::Once;

/// Readers catch panics of the libraries that they call; only panics that escape are findings. libFuzzer's hook would end the
/// run before they are caught.
static HOOK: Once = Once::new();

/// Writes the bytes to a file of this name in a temporary folder, and reads it.
pub fn with_file(data: &[u8], name: &str, read: impl FnOnce(&Path)) {
    HOOK.call_once(|| std::panic::set_hook(Box::new(|_| ())));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::create_dir_all(path.parent().expect("a parent")).expect("folders");
    std::fs::write(&path, data).expect("a file");
    read(&path);
}

/// Writes all bytes but the first to a file, whose name the first byte selects, and reads it.
pub fn with_one_of(data: &[u8], names: &[&str], read: impl FnOnce(&Path)) {
    if let Some((&kind, data)) = data.split_first() {
        with_file(data, names[usize::from(kind) % names.len()], read);
    }
}

/// Writes the bytes to a file of this name, and reads the dataset that contains it.
#[cfg(feature = "evaluation")]
pub fn with_dataset(data: &[u8], name: &str, kind: DatasetKind) {
    with_file(data, name, |path| {
        let levels = Path::new(name).components().count();
        let config = DataConfig {
            dataset: kind,
            root: path.ancestors().nth(levels).map(Path::to_owned),
            ..DataConfig::default()
        };
        if let Ok(frames) = config.open(Split::Val, None) {
            for i in 0..frames.len().min(3) {
                let _ = frames.load(i);
            }
        }
    });
}

/// Surveys a recording, and reads its frames with each topic of points.
pub fn recording(path: &Path) {
    let Ok(mut recording) = Recording::open(path) else {
        return;
    };
    let Ok(survey) = Survey::of(&mut recording) else {
        return;
    };
    for summary in survey.topics.iter().take(8) {
        let wanted = FrameOptions {
            points: Some(summary.topic.name.clone()),
            ..FrameOptions::default()
        };
        let Ok(frames) = Frames::of(&mut recording, &wanted) else {
            continue;
        };
        for frame in &frames.found {
            let _ = frames
                .read(&mut recording, frame)
                .and_then(|stored| stored.decode(&frames));
        }
    }
}
