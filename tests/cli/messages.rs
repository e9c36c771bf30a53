//! Error messages that name what is expected.

use super::*;

#[test]
fn numbers_of_the_wrong_form_are_answered_with_the_right_one() {
    let folder = room();
    for (option, value, words) in [
        ("--camera", "500,500,319", &["3 numbers", "FX,FY,CX,CY"][..]),
        (
            "--camera",
            "500,500,319,239,0.1",
            &["5 numbers", "give a file"],
        ),
        ("--size", "1280", &["WIDTHxHEIGHT", "640x480"]),
        ("--range", "3", &["LOW,HIGH", "0.5,8"]),
    ] {
        let args = ["complete", "rgb.png", "sparse.npy", option, value];
        refused(folder.path(), &args, words);
    }
}

#[test]
fn several_images_with_the_points_of_one_are_answered_with_what_to_give() {
    let folder = room();
    for part in ["frames", "points"] {
        std::fs::create_dir(folder.path().join(part)).unwrap();
    }
    std::fs::copy(asset("rgb.png"), folder.path().join("frames/a.png")).unwrap();
    let one = ["complete", "frames", "sparse.npy", "-o", "out"];
    refused(
        folder.path(),
        &one,
        &["no folder of points", "for several images give a folder"],
    );
    let run = ["complete", "frames", "points", "-o", "out"];
    let run = lsdc(folder.path()).args(run).assert().code(3);
    let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(said.contains("as in `points/a.npy`"), "{said}");
}

#[test]
fn a_size_of_another_shape_is_said() {
    let folder = room();
    for (size, stretched) in [("228x228", true), ("152x114", false), ("401x301", false)] {
        let args = [
            "complete",
            "rgb.png",
            "sparse.npy",
            "--size",
            size,
            "-o",
            size,
            "-q",
        ];
        let run = lsdc(folder.path()).args(args).assert().success();
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        let words = format!("warning: --size {size} stretches the image of 304x228");
        assert_eq!(said.contains(&words), stretched, "{said}");
    }
}
