//! Grouping of frames by scene, so that similar frames of a recording are not in both training and held-out data.

use lsdc_eval::data::Dataset;
use lsdc_files::error::{Error, Result};
use lsdc_rng::hash;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// The scene of every frame of a dataset.
#[derive(Clone, Debug)]
pub struct Scenes {
    of: Vec<String>,
    known: bool,
}

impl Scenes {
    /// Reads the scenes from a list (`FRAME,SCENE` in each line, for all frames), otherwise from the dataset, otherwise from
    /// the first folder in which the names of frames differ. Without folders, or with only one scene, scenes are unknown, and
    /// every frame counts as a scene.
    ///
    /// # Errors
    /// The list cannot be read, or has no scene for a frame.
    pub fn of(frames: &dyn Dataset, list: Option<&Path>) -> Result<Self> {
        let names: Vec<String> = (0..frames.len()).map(|index| frames.id(index)).collect();
        let known: Option<Vec<String>> = match list {
            Some(path) => Some(listed(path, &names)?),
            None => (0..frames.len()).map(|index| frames.scene(index)).collect(),
        };
        let found = known.or_else(|| folders(&names));
        let found = found.filter(|scenes| scenes.iter().any(|scene| *scene != scenes[0]));
        Ok(Self {
            known: found.is_some(),
            of: found.unwrap_or(names),
        })
    }

    /// Returns the scene of a frame.
    pub fn name(&self, frame: usize) -> &str {
        &self.of[frame]
    }

    /// Returns the unit of held-out data: `scenes`, or `frames` if scenes are unknown.
    pub fn unit(&self) -> &'static str {
        if self.known { "scenes" } else { "frames" }
    }

    /// Treats every frame as a scene.
    pub(super) fn unknown(frames: &dyn Dataset) -> Self {
        Self {
            of: (0..frames.len()).map(|index| frames.id(index)).collect(),
            known: false,
        }
    }

    /// Returns the frames, interleaved over scenes in the order of their hashes under `purpose`: the first frame of every
    /// scene, then the second frame of scenes that have one, and so on.
    pub(super) fn spread(
        &self,
        frames: &dyn Dataset,
        which: &[usize],
        purpose: &str,
    ) -> Vec<usize> {
        let mut scenes: BTreeMap<(u64, &str), Vec<usize>> = BTreeMap::new();
        for &index in which {
            let scene = self.name(index);
            let key = (hash(&[purpose, scene]), scene);
            scenes.entry(key).or_default().push(index);
        }
        let mut ranked = Vec::with_capacity(which.len());
        for (place, mut own) in scenes.into_values().enumerate() {
            own.sort_by_key(|&index| hash(&[purpose, &frames.id(index)]));
            ranked.extend(
                own.into_iter()
                    .enumerate()
                    .map(|(rank, i)| (rank, place, i)),
            );
        }
        ranked.sort_unstable();
        ranked.into_iter().map(|(_, _, index)| index).collect()
    }

    /// Returns the training frames, and `count` held-out frames of other scenes. Held-out scenes are those whose names have the
    /// smallest hashes, so that adding frames moves few. They are a tenth of the scenes, but no more than `count`, or as many
    /// as are needed for `count` frames; and at most half of all frames. The remaining frames of these scenes are in neither
    /// list.
    pub fn divide(&self, frames: &dyn Dataset, count: usize) -> (Vec<usize>, Vec<usize>) {
        let mut sizes: HashMap<&str, usize> = HashMap::new();
        for scene in &self.of {
            *sizes.entry(scene).or_default() += 1;
        }
        let mut scenes: Vec<&str> = sizes.keys().copied().collect();
        scenes.sort_by_key(|scene| (hash(&["held out", scene]), *scene));
        let count = count.min(self.of.len() / 2);
        let fewest = count.min(scenes.len() / 10);
        let mut left = self.of.len() / 2;
        let mut is_held_out: HashMap<&str, bool> = HashMap::new();
        let (mut scene_count, mut frame_count) = (0, 0);
        for scene in scenes {
            let size = sizes[scene];
            let hold_out = (scene_count < fewest || frame_count < count) && size <= left;
            if hold_out {
                (scene_count, frame_count, left) =
                    (scene_count + 1, frame_count + size, left - size);
            }
            is_held_out.insert(scene, hold_out);
        }
        let all = 0..self.of.len();
        let (held_out, training): (Vec<usize>, Vec<usize>) =
            all.partition(|&index| is_held_out[self.name(index)]);
        let mut measured = self.spread(frames, &held_out, "held out");
        measured.truncate(count);
        if held_out.len() > measured.len() {
            tracing::info!(
                "{scene_count} scenes of {} frames are held out; {} of these frames are measured",
                held_out.len(),
                measured.len()
            );
        }
        (training, measured)
    }
}

/// Returns the first folder in which names differ, for each name; `None` if a name has no folder there.
fn folders(names: &[String]) -> Option<Vec<String>> {
    let parts: Vec<Vec<&str>> = names.iter().map(|name| name.split('/').collect()).collect();
    let first = parts.first()?;
    let same = |depth: &usize| {
        let part = first.get(*depth);
        parts.iter().all(|parts| parts.get(*depth) == part)
    };
    let depth = (0..first.len()).take_while(same).count();
    let folder = |parts: &Vec<&str>| (parts.len() > depth + 1).then(|| parts[depth].to_owned());
    parts.iter().map(folder).collect()
}

fn listed(path: &Path, names: &[String]) -> Result<Vec<String>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let mut scenes = HashMap::new();
    let lines = text.lines().enumerate();
    for (i, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let Some((frame, scene)) = line.rsplit_once(',') else {
            let what = format!("line {} has no comma", i + 1);
            return Err(Error::format(path, what).hint("a line is FRAME,SCENE"));
        };
        scenes.insert(frame.trim(), scene.trim());
    }
    let scene = |name: &String| {
        let found = scenes.get(name.as_str()).map(|scene| (*scene).to_owned());
        found.ok_or_else(|| {
            Error::format(path, format!("has no scene of frame `{name}`"))
                .hint("a line is FRAME,SCENE; every frame needs one")
        })
    };
    names.iter().map(scene).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_eval::data::Frame;
    use std::collections::BTreeSet;

    /// Frames with only names.
    struct Named(Vec<String>);

    impl Dataset for Named {
        fn description(&self) -> String {
            "names".into()
        }

        fn len(&self) -> usize {
            self.0.len()
        }

        fn id(&self, index: usize) -> String {
            self.0[index].clone()
        }

        fn load(&self, _: usize) -> Result<Frame> {
            Err(Error::config("there are names only"))
        }
    }

    fn named<T: ToString>(names: impl IntoIterator<Item = T>) -> Named {
        Named(names.into_iter().map(|name| name.to_string()).collect())
    }

    #[test]
    fn scenes_are_the_first_folders_in_which_names_differ() {
        let kitchen = ["all/kitchen-1/a/007", "all/kitchen-1/b/1", "all/hall/c/2"];
        let scenes = Scenes::of(&named(kitchen), None).unwrap();
        assert_eq!(scenes.of, ["kitchen-1", "kitchen-1", "hall"]);
        assert_eq!(scenes.unit(), "scenes");
        // Neither numbers nor a single folder are scenes.
        for names in [["00017", "00018"], ["val/1", "val/2"], ["a/1", "2"]] {
            let scenes = Scenes::of(&named(names), None).unwrap();
            assert_eq!(
                (scenes.unit(), &scenes.of[..]),
                ("frames", &names.map(String::from)[..])
            );
        }
    }

    #[test]
    fn a_list_names_scenes_and_must_be_complete() {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("scenes.csv");
        std::fs::write(&list, "1,hall\n2,hall\n\nx,y, kitchen\n").unwrap();
        let scenes = Scenes::of(&named(["1", "x,y", "2"]), Some(&list)).unwrap();
        assert_eq!(scenes.of, ["hall", "kitchen", "hall"]);
        assert_eq!(scenes.unit(), "scenes");
        let missing = Scenes::of(&named(["1", "3"]), Some(&list)).unwrap_err();
        assert!(missing.to_string().contains("frame `3`"), "{missing}");
        std::fs::write(&list, "1 hall\n").unwrap();
        assert!(Scenes::of(&named(["1"]), Some(&list)).is_err());
    }

    #[test]
    fn no_scene_is_on_both_sides() {
        let frames = named((0..600).map(|i| format!("room{}/{i}", i % 30)));
        let scenes = Scenes::of(&frames, None).unwrap();
        let names =
            |some: &[usize]| -> BTreeSet<&str> { some.iter().map(|&i| scenes.name(i)).collect() };
        // A tenth of the scenes, with 20 frames each.
        let (training, held) = scenes.divide(&frames, 24);
        assert_eq!((training.len(), held.len()), (540, 24));
        assert_eq!(names(&held).len(), 3);
        assert!(names(&training).is_disjoint(&names(&held)));
        assert!(training.is_sorted());
        // As many scenes as are needed for this many frames.
        let (training, held) = scenes.divide(&frames, 100);
        assert_eq!((training.len(), held.len()), (500, 100));
        // At most half of all frames, whatever the sizes of scenes are.
        let lopsided = named((0..10).map(|i| {
            if i == 0 {
                "a/0".into()
            } else {
                format!("b/{i}")
            }
        }));
        let scenes = Scenes::of(&lopsided, None).unwrap();
        assert_eq!(scenes.divide(&lopsided, 4), ((1..10).collect(), vec![0]));
    }

    #[test]
    fn frames_of_unknown_scenes_are_divided_by_their_hashes() {
        let frames = named(0..40);
        let scenes = Scenes::of(&frames, None).unwrap();
        let mut order: Vec<usize> = (0..40).collect();
        order.sort_by_key(|&i| hash(&["held out", &i.to_string()]));
        let mut training = order.split_off(7);
        training.sort_unstable();
        assert_eq!(scenes.divide(&frames, 7), (training, order));
        assert_eq!(scenes.divide(&frames, 100).1.len(), 20);
        assert_eq!(scenes.divide(&frames, 0).0.len(), 40);
    }

    #[test]
    fn frames_are_spread_over_scenes() {
        let frames = named(["a/1", "a/2", "a/3", "b/1", "c/1", "c/2"]);
        let scenes = Scenes::of(&frames, None).unwrap();
        let order = scenes.spread(&frames, &[0, 1, 2, 3, 4, 5], "test");
        let of = |some: &[usize]| {
            some.iter()
                .map(|&i| scenes.name(i))
                .collect::<BTreeSet<_>>()
        };
        assert_eq!(of(&order[..3]), BTreeSet::from(["a", "b", "c"]));
        assert_eq!(of(&order[3..5]), BTreeSet::from(["a", "c"]));
        assert_eq!(of(&order[5..]), BTreeSet::from(["a"]));
    }
}
