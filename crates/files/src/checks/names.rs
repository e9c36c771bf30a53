//! Meaning of values by the names of files, arrays and channels.

use super::Warning;

/// Words that denote distances along the ray: `distance` in Hypersim and CARLA's lidar, `range` in `SemanticKITTI` and
/// Ouster, `perspective` in `AirSim`.
pub const RAY: [&str; 7] = [
    "distance",
    "distances",
    "range",
    "ray",
    "radial",
    "euclidean",
    "perspective",
];
/// Words that denote depth along the axis nevertheless, as in Isaac Sim's `distance_to_image_plane`.
const PLANAR: [&str; 2] = ["plane", "planar"];

/// Words that denote depth, in order of preference; `z` is the usual channel of EXR.
const DEPTH: [&str; 6] = ["z", "depth", "depths", "zdepth", "depthz", "sparse"];

/// Splits a name into lower-case words at characters that are not letters, and at camel-case boundaries.
fn words(name: &str) -> impl Iterator<Item = String> {
    let mut words = vec![String::new()];
    let mut before_small = false;
    for letter in name.chars() {
        let hump = letter.is_uppercase() && before_small;
        before_small = letter.is_lowercase();
        if !letter.is_alphabetic() || hump {
            words.push(String::new());
        }
        if letter.is_alphabetic()
            && let Some(word) = words.last_mut()
        {
            word.extend(letter.to_lowercase());
        }
    }
    words.into_iter().filter(|word| !word.is_empty())
}

/// Whether the name of a file, an array or a channel denotes distances along the ray.
pub fn is_ray_distance(name: &str) -> bool {
    let has = |known: &[&str]| words(name).any(|word| known.contains(&&word[..]));
    has(&RAY) && !has(&PLANAR)
}

/// Words that denote disparity or inverse depth, as in the results of stereo and of networks such as Depth Anything.
const INVERSE: [&str; 7] = [
    "disparity",
    "disparities",
    "disp",
    "inverse",
    "inv",
    "invdepth",
    "idepth",
];

/// Returns a warning if the name of a file, an array or a channel denotes values other than depths along the axis. `what`
/// names it in the text.
pub(crate) fn name_warning(name: &str, what: impl FnOnce() -> String) -> Option<Warning> {
    if is_ray_distance(name) {
        Some(Warning::RayDistance { name: what() })
    } else if words(name).any(|word| INVERSE.contains(&&word[..])) {
        Some(Warning::Inverse { name: what() })
    } else {
        None
    }
}

/// Ranks how well a name denotes depth: 0 is best; `None` if it denotes something else. The last word takes precedence, as
/// in `ViewLayer.Depth.Z`.
pub fn channel_rank(name: &str) -> Option<usize> {
    let words: Vec<String> = words(name).collect();
    let rank = |word: &String| DEPTH.iter().position(|known| known == word);
    let last = words.last().and_then(rank);
    let any = || {
        words
            .iter()
            .rev()
            .find_map(rank)
            .map(|rank| rank + DEPTH.len())
    };
    let ray = || is_ray_distance(name).then_some(2 * DEPTH.len());
    last.or_else(any).or_else(ray)
}

/// Returns the array of depths among the arrays of a file: the first of `usual_names` that exists, or else the array whose
/// name has the best [`channel_rank`], or else the only array.
pub(crate) fn depth_array<'a>(names: &'a [String], usual_names: &[&str]) -> Option<&'a String> {
    let known = usual_names
        .iter()
        .find_map(|known| names.iter().find(|name| name == known));
    let ranked = names
        .iter()
        .filter_map(|name| Some((channel_rank(name)?, name)));
    let only = names.first().filter(|_| names.len() == 1);
    known
        .or_else(|| ranked.min().map(|(_, name)| name))
        .or(only)
}

/// Lists the first few names in backticks.
pub(crate) fn quoted(names: &[String]) -> String {
    /// Largest number of listed names.
    const MOST: usize = 12;
    let listed = names.iter().take(MOST).map(|name| format!("`{name}`"));
    let text = listed.collect::<Vec<_>>().join(", ");
    if names.len() > MOST {
        format!("{text} and {} more", names.len() - MOST)
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ray_distances_are_known_by_whole_words() {
        for name in [
            "distance",
            "lidar_range",
            "RayDistance",
            "radial-depth",
            "a/Distance.V",
        ] {
            assert!(is_ray_distance(name), "{name}");
        }
        for name in [
            "depth",
            "arrange",
            "gray",
            "arrays",
            "Z",
            "distance_to_image_plane",
        ] {
            assert!(!is_ray_distance(name), "{name}");
        }
    }

    #[test]
    fn names_of_disparities_and_inverse_depths_are_doubted() {
        let warning = |name: &str| name_warning(name, || name.to_owned());
        for name in [
            "disparity",
            "left_disp",
            "inv_depth",
            "InverseDepth",
            "000_disparity_16",
        ] {
            let expected = Warning::Inverse {
                name: name.to_owned(),
            };
            assert_eq!(warning(name), Some(expected));
        }
        for name in ["depth", "display", "invalid", "Z"] {
            assert_eq!(warning(name), None);
        }
        assert!(matches!(
            warning("range"),
            Some(Warning::RayDistance { .. })
        ));
    }

    #[test]
    fn names_that_say_depth_come_first() {
        let names = [
            "B",
            "Depth.Z",
            "distance",
            "ViewLayer.Combined.R",
            "sparse_depth",
        ];
        let best = names.iter().filter(|name| channel_rank(name).is_some());
        assert_eq!(best.min_by_key(|name| channel_rank(name)), Some(&"Depth.Z"));
        assert!(channel_rank("distance") > channel_rank("my_depth_map"));
        assert_eq!(channel_rank("R"), None);
    }
}
