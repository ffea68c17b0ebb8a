//! The demo folder: what is saved loads again, and everything malformed is refused with one line
//! that names the file, the line and what to do.

mod random;

use offline::demo::{
    CameraSpec, ClampSample, ClampSpec, CloudFrame, Demo, DemoSpec, FORMAT, MarkerSample, Observations,
    RopeEnd, RopeSpec, SceneKind, StartState, TableSpec,
};
use std::fs;
use std::path::{Path, PathBuf};

fn sample(t_s: f64, z: f64) -> ClampSample {
    ClampSample {
        t_s,
        position_m: [0.0, 0.0, z],
        quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
        closed: true,
    }
}

fn cloud_demo() -> Demo {
    let frame = |t_s: f64| CloudFrame {
        t_s,
        points_m: (0..5).map(|i| [0.0625 * f64::from(i), 0.0, 0.5]).collect(),
    };
    Demo {
        name: "demo".to_owned(),
        spec: DemoSpec {
            format: FORMAT.to_owned(),
            scene: SceneKind::Lift,
            noise_m: 0.001,
            planar: false,
            notes: "made for a test".to_owned(),
            rope: RopeSpec {
                length_m: 0.25,
                diameter_m: 0.014,
                mass_kg: 0.0385,
                direction: [1.0, 0.0, 0.0],
                end_mass_kg: 0.0,
                roll_rad: 0.0,
                assumed: Vec::new(),
            },
            start: StartState::Straight,
            table: Some(TableSpec {
                height_m: 0.0,
                friction: 0.5,
            }),
            clamps: vec![ClampSpec {
                end: RopeEnd::Start,
                grip_m: 0.02,
                direction: None,
            }],
            cameras: vec![CameraSpec {
                name: "left".to_owned(),
                position_m: [0.0, 0.5, 0.5],
                quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
                width_px: 640,
                height_px: 480,
                focal_px: [385.0, 385.0],
                centre_px: [320.0, 240.0],
            }],
        },
        clamps: vec![vec![sample(0.0, 0.007), sample(0.1, 0.01), sample(0.2, 0.02)]],
        commanded: vec![Some(vec![sample(0.0, 0.007), sample(0.2, 0.03)])],
        observations: Observations::Clouds(vec![frame(0.0), frame(0.1)]),
    }
}

fn marker_demo() -> Demo {
    let marker = |t_s: f64, label: &str, s_m: f64| MarkerSample {
        t_s,
        marker: label.to_owned(),
        s_m,
        position_m: [s_m, 0.0, 0.007],
    };
    Demo {
        observations: Observations::Markers(vec![
            marker(0.0, "m1", 0.1),
            marker(0.0, "m2", 0.2),
            marker(0.1, "m1", 0.1),
        ]),
        ..cloud_demo()
    }
}

fn saved(demo: &Demo) -> (tempfile::TempDir, PathBuf) {
    let parent = tempfile::tempdir().expect("a temporary folder");
    let dir = parent.path().join("demo");
    demo.save(&dir).expect("the demo is sound");
    (parent, dir)
}

fn replace(file: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(file).expect("the file is there");
    assert!(text.contains(from), "{} lacks '{from}'", file.display());
    fs::write(file, text.replacen(from, to, 1)).expect("the file is writable");
}

/// Spoils a saved demo and checks that loading says where (`place` is file and line) and why.
fn refused(demo: &Demo, spoil: impl Fn(&Path), place: &str, why: &str) {
    let (_parent, dir) = saved(demo);
    spoil(&dir);
    let error = Demo::load(&dir).expect_err("it must be refused").to_string();
    let place = if place.is_empty() { dir } else { dir.join(place) };
    let place = place.display().to_string();
    assert!(error.starts_with(&format!("{place}: ")), "wrong place: {error}");
    assert!(error.contains(why), "wrong reason: {error}");
    assert!(!error.contains('\n'), "more than one line: {error}");
    let remedy = error.rsplit("; ").next().unwrap_or_default();
    assert!(error.contains("; ") && remedy.len() > 8, "no remedy: {error}");
}

/// One malformed demonstration: a file, a text in it and what replaces it.
macro_rules! refusals {
    ($($name:ident: $demo:ident, $file:literal, $from:literal => $to:literal, $place:literal, $why:literal;)*) => {
        $(#[test]
        fn $name() {
            refused(&$demo(), |dir| replace(&dir.join($file), $from, $to), $place, $why);
        })*
    };
}

refusals! {
    other_version: cloud_demo, "demo.toml", "genorm-demo/1\"" => "genorm-demo/2\"\nnew = 1", "demo.toml:1", "genorm-demo/2";
    wrong_format: cloud_demo, "demo.toml", "genorm-demo/1" => "genorm-demo/9", "demo.toml:1", "genorm-demo/9";
    unknown_key: cloud_demo, "demo.toml", "noise_m" => "temperature_k = 0.0\nnoise_m", "demo.toml:3", "temperature_k";
    unknown_scene: cloud_demo, "demo.toml", "\"lift\"" => "\"throw\"", "demo.toml:2", "throw";
    missing_key: cloud_demo, "demo.toml", "length_m = 0.25\n" => "", "demo.toml:6", "length_m";
    not_toml: cloud_demo, "demo.toml", "[rope]" => "[rope", "demo.toml:6", "]";
    no_noise: cloud_demo, "demo.toml", "noise_m = 0.001" => "noise_m = 0.0", "demo.toml:3", "noise_m";
    noise_in_millimetres: cloud_demo, "demo.toml", "noise_m = 0.001" => "noise_m = 0.1", "demo.toml:3", "noise_m = 0.1";
    noise_not_finite: cloud_demo, "demo.toml", "noise_m = 0.001" => "noise_m = nan", "demo.toml:3", "noise_m";
    rope_of_300_m: cloud_demo, "demo.toml", "length_m = 0.25" => "length_m = 300.0", "demo.toml:7", "length_m";
    rope_14_m_thick: cloud_demo, "demo.toml", "diameter_m = 0.014" => "diameter_m = 14.0", "demo.toml:8", "diameter_m";
    thicker_than_long: cloud_demo, "demo.toml", "diameter_m = 0.014" => "diameter_m = 0.14", "demo.toml:8", "diameter_m";
    mass_in_grams: cloud_demo, "demo.toml", "mass_kg = 0.0385" => "mass_kg = 38.5", "demo.toml:9", "density";
    mass_not_finite: cloud_demo, "demo.toml", "mass_kg = 0.0385" => "mass_kg = nan", "demo.toml:9", "density";
    mass_negative: cloud_demo, "demo.toml", "mass_kg = 0.0385" => "mass_kg = -0.0385", "demo.toml:9", "density";
    direction_not_unit: cloud_demo, "demo.toml", "direction = [1.0, 0.0" => "direction = [2.0, 0.0", "demo.toml:10", "direction";
    table_far_away: cloud_demo, "demo.toml", "height_m = 0.0" => "height_m = 700.0", "demo.toml:13", "height_m";
    friction_negative: cloud_demo, "demo.toml", "friction = 0.5" => "friction = -0.5", "demo.toml:14", "friction";
    grip_longer_than_rope: cloud_demo, "demo.toml", "grip_m = 0.02" => "grip_m = 0.3", "demo.toml:18", "grips 0.3 m";
    grip_of_nothing: cloud_demo, "demo.toml", "grip_m = 0.02" => "grip_m = 0.0", "demo.toml:18", "grips 0 m";
    lift_with_no_clamp: cloud_demo, "demo.toml", "[[clamps]]\nend = \"start\"\ngrip_m = 0.02\n" => "", "demo.toml:2", "0 clamps";
    same_end_twice: cloud_demo, "demo.toml", "[[clamps]]" => "[[clamps]]\nend = \"start\"\ngrip_m = 0.02\n[[clamps]]", "demo.toml:2", "2 clamps";
    camera_quaternion: cloud_demo, "demo.toml", "[0.0, 0.0, 0.0, 1.0]" => "[0.0, 0.0, 0.0, 2.0]", "demo.toml:23", "camera 'left'";
    cameras_of_one_name: cloud_demo, "demo.toml", "[[cameras]]" => "[[cameras]]\nname = \"left\"\nposition_m = [0.0, 0.5, 0.5]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\nwidth_px = 640\nheight_px = 480\nfocal_px = [385.0, 385.0]\ncentre_px = [320.0, 240.0]\n[[cameras]]", "demo.toml:29", "two cameras are called 'left'";
    camera_focal_length: cloud_demo, "demo.toml", "[385.0, 385.0]" => "[385.0, 0.0]", "demo.toml:20", "optics";
    clamp_column_missing: cloud_demo, "clamp_0.csv", "z_m," => "", "clamp_0.csv:1", "'z_m' is missing";
    clamp_column_unknown: cloud_demo, "clamp_0.csv", "z_m," => "z_mm,", "clamp_0.csv:1", "'z_mm'";
    clamp_column_twice: cloud_demo, "clamp_0.csv", "z_m," => "y_m,", "clamp_0.csv:1", "twice";
    clamp_half_a_quaternion: cloud_demo, "clamp_0.csv", "closed" => "qx,closed", "clamp_0.csv:1", "1 of the columns";
    clamp_row_cut: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01,1" => "0.1,0,0", "clamp_0.csv:3", "3 values in 5 columns";
    clamp_empty_line: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01,1" => "", "clamp_0.csv:3", "1 values in 5 columns";
    clamp_file_cut: cloud_demo, "clamp_0.csv", "0.02,1\n" => "0.02,1", "clamp_0.csv:4", "cut short";
    clamp_not_a_number: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01" => "0.1,0,zero,0.01", "clamp_0.csv:3", "'zero'";
    clamp_nan: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01" => "0.1,0,NaN,0.01", "clamp_0.csv:3", "NaN";
    clamp_infinite: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01" => "0.1,0,inf,0.01", "clamp_0.csv:3", "inf";
    clamp_time_goes_back: cloud_demo, "clamp_0.csv", "0.1,0" => "0.3,0", "clamp_0.csv:4", "0.3 to 0.2";
    clamp_time_stands: cloud_demo, "clamp_0.csv", "0.1,0" => "0,0", "clamp_0.csv:3", "from 0 to 0";
    clamp_in_millimetres: cloud_demo, "clamp_0.csv", "0.1,0,0,0.01" => "0.1,0,250,0.01", "clamp_0.csv:3", "too far";
    clamp_half_closed: cloud_demo, "clamp_0.csv", "0.01,1" => "0.01,0.5", "clamp_0.csv:3", "closed";
    clamp_quaternion_not_unit: cloud_demo, "clamp_0.csv", "t_s,x_m,y_m,z_m,closed\n0,0,0,0.007,1\n0.1,0,0,0.01,1\n0.2,0,0,0.02,1\n"
        => "t_s,x_m,y_m,z_m,qx,qy,qz,qw,closed\n0,0,0,0.007,0,0,0,1,1\n0.1,0,0,0.01,0,0,0,0.9,1\n", "clamp_0.csv:3", "norm 0.9";
    clamp_never_closed: cloud_demo, "clamp_0.csv", "0,0,0,0.007,1\n0.1,0,0,0.01,1\n0.2,0,0,0.02,1\n" => "0,0,0,0.007,0\n0.1,0,0,0.01,0\n0.2,0,0,0.02,0\n", "clamp_0.csv", "never holds";
    clamp_without_rows: cloud_demo, "clamp_0.csv", "0,0,0,0.007,1\n0.1,0,0,0.01,1\n0.2,0,0,0.02,1\n" => "", "clamp_0.csv", "no rows";
    commanded_time_goes_back: cloud_demo, "clamp_0_commanded.csv", "0.2,0" => "-0.2,0", "clamp_0_commanded.csv:3", "t_s";
    clouds_column: cloud_demo, "clouds.csv", "file" => "path", "clouds.csv:1", "'path'";
    clouds_time_goes_back: cloud_demo, "clouds.csv", "0.1," => "-0.1,", "clouds.csv:3", "t_s";
    clouds_file_missing: cloud_demo, "clouds.csv", "0001.ply" => "0007.ply", "clouds.csv:3", "0007.ply";
    clouds_file_twice: cloud_demo, "clouds.csv", "0001.ply" => "0000.ply", "clouds.csv:3", "line 2 too";
    clouds_file_outside: cloud_demo, "clouds.csv", "clouds/0001.ply" => "../0001.ply", "clouds.csv:3", "inside";
    clouds_none: cloud_demo, "clouds.csv", "0,clouds/0000.ply\n0.1,clouds/0001.ply\n" => "", "clouds.csv", "no rows";
    markers_column: marker_demo, "markers.csv", "s_m," => "", "markers.csv:1", "'s_m'";
    markers_time_goes_back: marker_demo, "markers.csv", "0.1,m1" => "-0.1,m1", "markers.csv:4", "goes back";
    markers_outside_the_rope: marker_demo, "markers.csv", "0,m2,0.2" => "0,m2,0.9", "markers.csv:3", "0.9";
    markers_twice: marker_demo, "markers.csv", "0,m2,0.2" => "0,m1,0.1", "markers.csv:3", "twice";
    markers_move_along: marker_demo, "markers.csv", "0.1,m1,0.1" => "0.1,m1,0.15", "markers.csv:4", "moves along";
    markers_nan: marker_demo, "markers.csv", "0,m2,0.2" => "0,m2,nan", "markers.csv:3", "nan";
    markers_without_a_label: marker_demo, "markers.csv", "0,m2," => "0,,", "markers.csv:3", "label";
    markers_row_cut: marker_demo, "markers.csv", "0.1,0,0.007\n" => "0.1,0\n", "markers.csv:2", "5 values in 6";
}

#[test]
fn clamps_that_grip_the_whole_rope_are_refused() {
    let spoil = |dir: &Path| {
        replace(&dir.join("demo.toml"), "\"lift\"", "\"swing\"");
        let two = "[[clamps]]\nend = \"end\"\ngrip_m = 0.24\n[[clamps]]";
        replace(&dir.join("demo.toml"), "[[clamps]]", two);
    };
    refused(&cloud_demo(), spoil, "demo.toml:16", "the clamps grip 0.26 m");
}

#[test]
fn an_end_gripped_twice_is_refused() {
    let spoil = |dir: &Path| {
        replace(&dir.join("demo.toml"), "\"lift\"", "\"free\"");
        let two = "[[clamps]]\nend = \"start\"\ngrip_m = 0.02\n[[clamps]]";
        replace(&dir.join("demo.toml"), "[[clamps]]", two);
    };
    refused(&cloud_demo(), spoil, "demo.toml:20", "another clamp grips");
}

#[test]
fn neither_clouds_nor_markers_is_refused() {
    let spoil = |dir: &Path| fs::remove_file(dir.join("clouds.csv")).expect("the file is there");
    refused(&cloud_demo(), spoil, "", "neither");
}

#[test]
fn both_clouds_and_markers_are_refused() {
    let spoil = |dir: &Path| {
        let text = "t_s,marker,s_m,x_m,y_m,z_m\n0,a,0.1,0,0,0\n";
        fs::write(dir.join("markers.csv"), text).expect("the folder is writable");
    };
    refused(&cloud_demo(), spoil, "", "both");
}

#[test]
fn a_missing_clamp_file_is_refused() {
    let spoil = |dir: &Path| fs::remove_file(dir.join("clamp_0.csv")).expect("the file is there");
    refused(&cloud_demo(), spoil, "clamp_0.csv", "reading failed");
}

#[test]
fn an_undeclared_clamp_file_is_refused() {
    let spoil = |dir: &Path| {
        fs::copy(dir.join("clamp_0.csv"), dir.join("clamp_1.csv")).expect("the folder is writable");
    };
    refused(&cloud_demo(), spoil, "clamp_1.csv", "declares 1 clamps");
}

#[test]
fn a_folder_that_is_not_there_or_a_file_is_refused() {
    let load = |path: &Path| Demo::load(path).expect_err("it is no demo").to_string();
    let error = load(Path::new("no/such/folder"));
    assert!(
        error.contains("demo.toml") && error.contains("existing demo folder"),
        "{error}"
    );
    let (_parent, dir) = saved(&cloud_demo());
    let file = load(&dir.join("demo.toml"));
    assert!(file.ends_with("give the folder that holds it"), "{file}");
}

#[test]
fn a_truncated_binary_cloud_is_refused() {
    let spoil = |dir: &Path| {
        let file = dir.join("clouds/0001.ply");
        let bytes = fs::read(&file).expect("the file is there");
        fs::write(&file, &bytes[..bytes.len() - 8]).expect("the file is writable");
    };
    refused(&cloud_demo(), spoil, "clouds/0001.ply", "ends before");
}

#[test]
fn a_binary_cloud_with_nan_is_refused() {
    let spoil = |dir: &Path| {
        let file = dir.join("clouds/0001.ply");
        let mut bytes = fs::read(&file).expect("the file is there");
        let last = bytes.len() - 4;
        bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
        fs::write(&file, bytes).expect("the file is writable");
    };
    refused(&cloud_demo(), spoil, "clouds/0001.ply", "point 4 is not finite");
}

/// Replaces a cloud by text and expects a refusal at a place in it.
fn cloud_refused(text: &str, line: &str, why: &str) {
    let spoil = |dir: &Path| fs::write(dir.join("clouds/0001.ply"), text).expect("the folder is writable");
    refused(&cloud_demo(), spoil, &format!("clouds/0001.ply{line}"), why);
}

const HEADER: &str = "ply\nformat ascii 1.0\n";

/// A cloud in ASCII that says it has so many points, and these.
fn text_cloud(vertices: usize, points: &str) -> String {
    let axes = "property float x\nproperty float y\nproperty float z\n";
    format!("{HEADER}element vertex {vertices}\n{axes}end_header\n{points}")
}

#[test]
fn a_truncated_text_cloud_is_refused() {
    let text = text_cloud(3, "0 0 0\n1 1 1\n");
    cloud_refused(&text, "", "ends before");
}

#[test]
fn a_cloud_with_more_points_than_its_header_says_is_refused() {
    let text = text_cloud(1, "0 0 0\n1 1 1\n");
    cloud_refused(&text, "", "data follow");
}

#[test]
fn an_empty_cloud_is_refused() {
    let text = text_cloud(0, "");
    cloud_refused(&text, "", "the cloud is empty (clouds.csv:3)");
}

#[test]
fn a_cloud_without_height_is_refused() {
    let text =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n0 0\n";
    cloud_refused(text, "", "'z'");
}

#[test]
fn a_cloud_without_vertices_is_refused() {
    cloud_refused(
        "ply\nformat ascii 1.0\nelement face 0\nproperty float x\nend_header\n",
        "",
        "vertex",
    );
}

#[test]
fn a_cloud_with_nan_is_refused() {
    let text = text_cloud(1, "0 nan 0\n");
    cloud_refused(&text, ":8", "drop points without depth");
}

#[test]
fn a_cloud_in_millimetres_is_refused() {
    let text = text_cloud(1, "0 250 0\n");
    cloud_refused(&text, "", "250 m away");
}

#[test]
fn a_file_that_is_no_cloud_is_refused() {
    cloud_refused("solid rope\n", ":1", "not a readable PLY file");
}

#[test]
fn text_and_double_precision_clouds_with_colours_load() {
    let (_parent, dir) = saved(&cloud_demo());
    let body = "element vertex 1\nproperty uchar red\nproperty double z\nproperty float x\nproperty float y\n\
                element face 1\nproperty list uchar int vertex_index\nend_header\n9 0.1 0.2 0.3\n3 0 0 0\n";
    fs::write(dir.join("clouds/0001.ply"), format!("{HEADER}{body}")).expect("the folder is writable");
    let demo = Demo::load(&dir).expect("the cloud is sound");
    let Observations::Clouds(frames) = &demo.observations else {
        panic!("clouds were saved");
    };
    let expected = [f64::from(0.2f32), f64::from(0.3f32), 0.1];
    assert_eq!(frames[1].points_m, vec![expected]);
}

#[test]
fn tables_with_nothing_in_them_or_old_line_ends_are_refused_as_that() {
    for (text, why) in [
        ("", "it is empty"),
        ("\n \n", "it is empty"),
        ("t_s,x_m\r0,0\r", "end in CR alone"),
    ] {
        let spoil = |dir: &Path| fs::write(dir.join("clamp_0.csv"), text).expect("the folder is writable");
        refused(&cloud_demo(), spoil, "clamp_0.csv", why);
    }
}

#[test]
fn tables_written_on_other_systems_load() {
    let (_parent, dir) = saved(&cloud_demo());
    let text = "\u{feff}closed, z_m ,y_m,x_m,t_s\r\ntrue,0.007,0,0,0\r\nfalse,0.01,0,0,1e-1\r\n";
    fs::write(dir.join("clamp_0.csv"), text).expect("the folder is writable");
    let demo = Demo::load(&dir).expect("the table is sound");
    assert_eq!(demo.clamps[0][1].position_m, [0.0, 0.0, 0.01]);
    assert_eq!(demo.clamps[0][1].t_s, 0.1);
    assert!(demo.clamps[0][0].closed && !demo.clamps[0][1].closed);
}

/// Makes of each quaternion the one of q and -q that is nearer to the one before.
fn same_signs(path: &mut [ClampSample]) {
    for k in 1..path.len() {
        let before = path[k - 1].quaternion_xyzw;
        let now = &mut path[k].quaternion_xyzw;
        if before.iter().zip(now.iter()).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
            now.iter_mut().for_each(|c| *c = -*c);
        }
    }
}

/// q and -q are one orientation, and exporters that keep qw above zero change between them; what interpolates would turn
/// the clamp right round.
#[test]
fn a_quaternion_that_changes_its_sign_is_read_as_no_turn() {
    let turned = |t_s: f64, angle: f64, sign: f64| ClampSample {
        quaternion_xyzw: [sign * (0.5 * angle).sin(), 0.0, 0.0, sign * (0.5 * angle).cos()],
        ..sample(t_s, 0.01)
    };
    let mut demo = cloud_demo();
    demo.clamps = vec![vec![
        turned(0.0, 3.1, 1.0),
        turned(0.1, 3.15, -1.0),
        turned(0.2, 3.18, 1.0),
    ]];
    demo.commanded = vec![Some(demo.clamps[0].clone())];
    let (_parent, dir) = saved(&demo);
    let loaded = Demo::load(&dir).expect("it was saved");
    for path in [
        &loaded.clamps[0],
        loaded.commanded[0].as_ref().expect("it was saved"),
    ] {
        let expected = [
            turned(0.0, 3.1, 1.0),
            turned(0.1, 3.15, 1.0),
            turned(0.2, 3.18, 1.0),
        ];
        assert_eq!(path[..], expected);
    }
}

#[test]
fn an_unsound_demo_is_not_saved_at_all() {
    let parent = tempfile::tempdir().expect("a temporary folder");
    let dir = parent.path().join("demo");
    let mut empty = cloud_demo();
    empty.observations = Observations::Clouds(vec![CloudFrame {
        t_s: 0.0,
        points_m: Vec::new(),
    }]);
    assert!(empty.save(&dir).is_err());
    let mut unseen = marker_demo();
    unseen.spec.scene = SceneKind::Free;
    unseen.spec.start = StartState::Moving;
    unseen.observations = Observations::Markers(Vec::new());
    let error = unseen.save(&dir).expect_err("nothing was seen").to_string();
    assert!(error.contains("there are no samples"), "{error}");
    let mut thick = cloud_demo();
    thick.spec.rope.diameter_m = 14.0;
    assert!(thick.save(&dir).is_err());
    let left = fs::read_dir(parent.path())
        .expect("the folder is readable")
        .count();
    assert_eq!(left, 0, "something was left behind");
}

#[test]
fn saving_replaces_a_demo_but_no_other_folder() {
    let (parent, dir) = saved(&cloud_demo());
    marker_demo().save(&dir).expect("a demo may be replaced");
    assert_eq!(Demo::load(&dir).expect("it was saved"), marker_demo());
    assert_eq!(
        fs::read_dir(parent.path())
            .expect("the folder is readable")
            .count(),
        1
    );
    let other = parent.path().join("thesis");
    fs::create_dir(&other).expect("the folder is writable");
    fs::write(other.join("chapter.txt"), "words").expect("the folder is writable");
    let error = cloud_demo()
        .save(&other)
        .expect_err("it holds something else")
        .to_string();
    assert!(error.contains("something other"), "{error}");
    assert!(other.join("chapter.txt").exists());
}

#[test]
fn saving_never_replaces_a_file() {
    let parent = tempfile::tempdir().expect("a temporary folder");
    let file = parent.path().join("f.txt");
    fs::write(&file, "precious").expect("the folder is writable");
    let error = cloud_demo().save(&file).expect_err("it is a file").to_string();
    assert!(
        error.contains("f.txt: this is no folder; choose a folder"),
        "{error}"
    );
    assert_eq!(fs::read_to_string(&file).expect("it is there"), "precious");
}

#[test]
fn saving_keeps_what_a_user_added_to_a_demo() {
    for added in [
        "notes.txt",
        "clouds/photo.jpg",
        "clamp_left.csv",
        "clouds/more.ply/notes.txt",
    ] {
        let (_parent, dir) = saved(&cloud_demo());
        let file = dir.join(added);
        fs::create_dir_all(file.parent().expect("it is in the folder")).expect("the folder is writable");
        fs::write(&file, "words").expect("the folder is writable");
        let error = marker_demo()
            .save(&dir)
            .expect_err("the file would be lost")
            .to_string();
        let first = added.trim_end_matches("/notes.txt");
        assert!(
            error.contains(&format!("{first}: this is no part")),
            "{added}: {error}"
        );
        assert_eq!(fs::read_to_string(&file).expect("it is there"), "words");
    }
}

#[test]
fn a_demo_with_all_that_the_format_knows_is_replaced() {
    let (_parent, dir) = saved(&cloud_demo());
    fs::rename(dir.join("clouds/0001.ply"), dir.join("clouds/0001.PCD")).expect("the folder is writable");
    marker_demo().save(&dir).expect("nothing else is in it");
    cloud_demo().save(&dir).expect("nothing else is in it");
    assert_eq!(Demo::load(&dir).expect("it was saved"), cloud_demo());
}

#[test]
fn a_start_that_the_data_do_not_show_is_refused_at_its_line() {
    let spoil = |dir: &Path| {
        let file = dir.join("demo.toml");
        replace(&file, "\"lift\"", "\"free\"\nstart = \"moving\"");
    };
    refused(&cloud_demo(), spoil, "demo.toml:3", "without markers");
}
