//! Published results, and notes on their errors.

use lsdc_eval::predict::SystemKind;
use lsdc_eval::report::Row;

/// The metrics of tables 1 and 4: RMSE in metres, REL, and shares below 1.25, 1.25^2 and 1.25^3 in per cent.
pub(super) type Errors = [Option<f64>; 5];

/// Fang et al., table 1: NYU Depth v2, 500 points.
pub(super) const TABLE_1: [(&str, Errors); 4] = [
    (
        "S2D (table 1)",
        [Some(0.230), Some(0.044), Some(97.1), Some(99.4), Some(99.8)],
    ),
    (
        "steering kernels (table 1)",
        [Some(0.221), Some(0.043), Some(96.87), None, None],
    ),
    (
        "LSK (table 1)",
        [Some(0.198), Some(0.034), Some(97.73), None, None],
    ),
    (
        "LSE, this method (table 1)",
        [Some(0.148), Some(0.031), Some(98.72), None, None],
    ),
];

pub(super) const TABLE_1_NOTES: [&str; 2] = [
    "The row of S2D is, digit for digit, the one that sparse-to-dense gives for 200 points; at 500 \
     points it is usually quoted with RMSE 0.204, REL 0.043.",
    "Published rows were measured on all 654 official test frames.",
];

/// Fang et al., section 4.4: RMSE in metres at 1000 points, clean, with noise, with noise and IRLS.
pub(super) const NOISE: [f64; 3] = [0.129, 0.366, 0.331];

pub(super) const NOISE_NOTES: [&str; 1] = [
    "The noise only adds: its mean is 0.5 m on the 30 % of points that have it, so that losses which \
     merely grow more slowly follow it in part.",
];

/// Fang et al., table 3: 120x160 to 360x480, RMSE in metres and REL, with its two columns swapped.
pub(super) const TABLE_3: [(&str, [f64; 2]); 3] = [
    ("S2D (table 3)", [1.367, 0.487]),
    ("LSK (table 3)", [0.251, 0.059]),
    ("LSE, this method (table 3)", [0.215, 0.046]),
];

pub(super) const TABLE_3_NOTES: [&str; 1] = [
    "The paper prints RMSE 0.046 with REL 0.215 for LSE, which no frames of NYU can have; its columns \
     are taken to be exchanged, here put back. It states no threshold of edges for SEE.",
];

/// Fang et al., table 4: DIODE, 1000 points, trained on NYU: RMSE in metres, REL, share below 1.25;
/// indoor, then outdoor.
pub(super) const TABLE_4: [(&str, [f64; 3], [f64; 3]); 4] = [
    (
        "S2D (table 4)",
        [0.462, 0.094, 95.50],
        [7.648, 1.827, 57.00],
    ),
    (
        "LSK (table 4)",
        [0.388, 0.061, 96.23],
        [5.361, 2.520, 71.68],
    ),
    (
        "CSPN (table 4)",
        [0.292, 0.050, 97.52],
        [4.671, 2.665, 76.64],
    ),
    (
        "LSE, this method (table 4)",
        [0.289, 0.061, 96.55],
        [4.227, 1.827, 71.32],
    ),
];

pub(super) const TABLE_4_NOTES: [&str; 2] = [
    "Relative errors above 1 outdoors can only come from pixels with next to no depth: the validity \
     mask, or the sensor's least distance, was not applied. `diode-paper` follows that, \
     `diode-masked` applies the mask, `diode-robustdc` is the protocol of OMNI-DC.",
    "S2D and LSE share REL 1.827 outdoors to the last digit.",
];

/// Fang et al., table 5: millions of parameters, milliseconds on their GPU.
pub(super) const TABLE_5: [(&str, f64, f64); 4] = [
    ("S2D (table 5)", 63.6, 22.0),
    ("LSK (table 5)", 13.4, 114.0),
    ("CSPN (table 5)", 256.1, 67.0),
    ("LSE, this method (table 5)", 3.47, 15.0),
];

pub(super) const TABLE_5_NOTES: [&str; 1] =
    ["Published times are of GPUs; the others are of this machine, on the device that is named."];

/// RMSE in metres, REL, and the share below 1.25 in per cent.
type Scores = (f64, f64, Option<f64>);

/// Published results of a system on NYU Depth v2.
pub(super) struct PublishedSystem {
    pub(super) kind: SystemKind,
    /// Scores by row label.
    pub(super) rows: &'static [(&'static str, Scores)],
    /// Description of the training.
    pub(super) training: &'static str,
}

/// Published results of the three systems.
pub(super) const SYSTEMS: [PublishedSystem; 3] = [
    PublishedSystem {
        kind: SystemKind::S2d,
        rows: &[
            (
                "S2D, 200 points (its README; table 1)",
                (0.230, 0.044, Some(97.1)),
            ),
            (
                "S2D, 500 points (as it is usually quoted)",
                (0.204, 0.043, Some(97.8)),
            ),
        ],
        training: "20 epochs of 47,584 frames, 59,480 steps of 16",
    },
    PublishedSystem {
        kind: SystemKind::Cspn,
        rows: &[("CSPN, 500 points (its README)", (0.117, 0.016, None))],
        training: "40 epochs of 47,584 frames, 237,920 steps of 8",
    },
    PublishedSystem {
        kind: SystemKind::Lsk,
        rows: &[("LSK, 500 points (table 1)", (0.198, 0.034, Some(97.73)))],
        training: "40 epochs of the frames of sparse-to-dense",
    },
];

pub(super) const SYSTEMS_NOTES: [&str; 5] = [
    "Published rows were measured on all 654 official test frames, after trainings of days on GPUs; the others here.",
    "The paper's row of S2D at 500 points is the one that sparse-to-dense gives for 200.",
    "The 256.078 M parameters of CSPN have 37.956 M of layers that the authors' program makes and never runs.",
    "The 13.422 M of LSK are those of its refinement; the network of the kernels has 3.065 M more.",
    "CSPN's paper puts known depths back after every step, as is done here; the last version of its program puts \
     the network's own first depths there.",
];

/// Returns a row of published results.
pub(super) fn row(label: &str, values: Vec<Option<f64>>) -> Row {
    Row {
        label: label.to_owned(),
        unranked: true,
        values,
    }
}

/// Returns notes for a section.
pub(super) fn notes(notes: &[&str]) -> Vec<String> {
    notes.iter().map(|note| (*note).to_owned()).collect()
}
