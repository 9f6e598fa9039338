//! Pictures: gathered light that can be computed by hand, views of every kind, and the files that people open.
//!
//! Seeds are fixed; the bound of each statistical test is at least four standard deviations of its estimate.

mod common;

use common::{Model, bin, fails, furnace, json, number, ok};
use enf_image::{Loaded, read_exr};
use enf_layout::segment::{ExtentKind, StageKind};
use enf_store::{StageReader, StoreDir};
use serde_json::Value;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Renders a store into `dir/name`, all other flags given; returns the picture of a view.
fn render(store: &Path, dir: &Path, name: &str, view: &str, flags: &[&str]) -> Loaded {
    let out = dir.join(name);
    ok(bin("enf-render")
        .arg(store)
        .arg("-o")
        .arg(&out)
        .args(["--quiet", "--force", "--view", view, "--stats"])
        .arg(dir.join("render.json"))
        .args(flags));
    let file = view.replace(':', "-");
    read_exr(&out.join(format!("{file}.exr"))).unwrap()
}

/// Everything but the pictures.
fn light(scene: &Path, photons: &str, partition: &[&str]) -> PathBuf {
    common::light(scene, photons, partition, &[])
}

/// [`furnace`], whose walls reflect half, with white things in it.
fn furnace_with(dir: &Path, things: &Model) -> PathBuf {
    let scene = furnace(dir, 0.5);
    things.write(&dir.join("things.obj"), "newmtl white\nKd 1 1 1\n");
    let text = std::fs::read_to_string(&scene).unwrap();
    std::fs::write(&scene, text.replace("[[view]]", "[[mesh]]\nfile = \"things.obj\"\n[[view]]"))
        .unwrap();
    scene
}

fn mean(picture: &Loaded, channel: &str) -> f64 {
    let values = picture.channel(channel).unwrap();
    values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64
}

const GATHER: [&str; 2] = ["--indirect", "final-gather"];

/// A closed box that glows and reflects alike everywhere: radiance is Le / (1 - rho), in one room and in many.
#[test]
fn a_furnace_is_even() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnace(dir.path(), 0.5);
    for rooms in ["1", "8"] {
        let store = light(&scene, "400k", &["--rooms", rooms]);
        let flags = ["--width", "40", "--height", "40", "--samples", "8", "--max-samples", "8"];
        let gather = [&GATHER[..], &flags[..], &["--gather-rays", "16"]].concat();
        let picture = render(&store, dir.path(), "g", "in", &gather);
        // All but what the walls send out themselves, and that once reflected: rho (L - Le). Half of it is from the map,
        // which is a little dark within 0.1 m of edges, a tenth of the walls; the rest is from 25,600 paths.
        let found = mean(&picture, "indirect.G");
        assert!((found - 1.0).abs() < 0.03, "{found} in {rooms} rooms");
        assert!((mean(&picture, "G") - 4.0).abs() < 0.05, "in {rooms} rooms");
    }
}

/// The same with a swarm of small white things in it that neither glow nor absorb: radiance is the same, on them and behind
/// them. Most gather rays end on one of them, which is a fiftieth of the disc that a hundred photons would fill.
#[test]
fn a_furnace_is_even_about_small_things() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = Model::default();
    model.object("things");
    model.material("white");
    for i in 0..125 {
        let [x, y, z] = [i % 5, i / 5 % 5, i / 25].map(|c| 0.24 * f64::from(c));
        let centre = [2.7 + x, 1.5 + y, 1.5 + z];
        model.turned(centre, [0.06, 0.05, 0.06], 20.0 + 13.0 * f64::from(i));
    }
    let scene = furnace_with(dir.path(), &model);
    let store = light(&scene, "200k", &[]);
    let flags = ["--width", "40", "--height", "40", "--samples", "8", "--max-samples", "8"];
    let gather = [&GATHER[..], &flags[..], &["--gather-rays", "16"]].concat();
    let found = mean(&render(&store, dir.path(), "g", "in", &gather), "G");
    // With the discs' areas alone it is 3.4. What is left are discs over several things at once, of which chance hides the gaps.
    assert!((found - 4.0).abs() < 0.08, "{found}");
}

/// Things so small that they have hardly a photon, in a room full of them, are as bright as all else where the photon map is seen directly.
#[test]
fn things_with_hardly_a_photon_are_not_dark() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = Model::default();
    model.object("rails");
    model.material("white");
    for i in 0..12 {
        let [y, z] = [i % 4, i / 4].map(|c| 1.3 + 0.35 * f64::from(c));
        model.turned([3.2, y, z], [0.9, 0.012, 0.012], 4.0 * f64::from(i));
    }
    let scene = furnace_with(dir.path(), &model);
    let store = light(&scene, "8k", &[]);
    let flags = ["--width", "160", "--height", "160", "--samples", "8", "--max-samples", "8"];
    let picture = render(&store, dir.path(), "m", "in", &flags);
    let [light, albedo] = ["G", "albedo.G"].map(|c| picture.channel(c).unwrap());
    // Walls reflect half; what is seen whole is of a rail.
    let rails: Vec<f64> =
        (0..light.len()).filter(|&i| albedo[i] > 0.99).map(|i| f64::from(light[i])).collect();
    assert!(rails.len() > 300, "{} pixels of rails", rails.len());
    let found = rails.iter().sum::<f64>() / rails.len() as f64;
    assert!((found - 4.0).abs() < 0.2, "{found} on {} pixels", rails.len());
}

/// Smoothing moves light between pixels and neither makes nor loses any: not in either room, nor of the pixels that see both, at
/// the doorway between a bright one and a dark one. Both pictures are of the same rays. And it smooths: neighbours on an open wall,
/// and along edges, differ by less.
#[test]
fn smoothing_keeps_the_light() {
    let dir = tempfile::tempdir().unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/scenes");
    let scene = dir.path().join("two-rooms.toml");
    for name in ["two-rooms.toml", "two-rooms.obj", "two-rooms.mtl"] {
        std::fs::copy(scenes.join(name), dir.path().join(name)).unwrap();
    }
    let store = light(&scene, "60k", &[]);
    // Two bands and more: what is exchanged across their edges counts as well.
    let (width, height) = (256, 192);
    let size = ["--width", "256", "--height", "192", "--samples", "4", "--max-samples", "4"];
    let [plain, smooth] = ["0", "0.25"].map(|share| {
        let flags = [&GATHER[..], &size[..], &["--gather-smoothing", share]].concat();
        render(&store, dir.path(), share, "west", &flags)
    });
    let [rooms, mixed] = ["room.ID", "room.mixed"].map(|c| plain.channel(c).unwrap().to_vec());
    let of = |i: usize| if mixed[i] > 0.0 { 2 } else { rooms[i] as usize };
    for place in 0..3 {
        let pixels: Vec<usize> = (0..rooms.len()).filter(|&i| of(i) == place).collect();
        assert!(pixels.len() > 100, "place {place} has {} pixels", pixels.len());
        for channel in ["indirect.R", "indirect.G", "indirect.B"] {
            let sum = |picture: &Loaded| {
                let values = picture.channel(channel).unwrap();
                pixels.iter().map(|&i| f64::from(values[i])).sum::<f64>()
            };
            let ratio = sum(&smooth) / sum(&plain);
            assert!((ratio - 1.0).abs() < 1e-3, "place {place}, {channel}: {ratio}");
        }
    }
    // Squares of differences to the pixel beside, where both see one surface, and where both see the same two.
    let normal =
        |i: usize| ["X", "Y", "Z"].map(|c| plain.channel(&format!("normal.{c}")).unwrap()[i]);
    let length = |i: usize| normal(i).iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
    for edges in [false, true] {
        let noise = |picture: &Loaded| {
            let light = picture.channel("indirect.G").unwrap();
            let mut squares = 0.0;
            for y in 1..height {
                for x in 1..width {
                    let (i, j) = (y * width + x, y * width + x - 1);
                    let apart = (0..3).map(|c| (normal(i)[c] - normal(j)[c]).abs()).sum::<f32>();
                    let are_edges = [i, j].map(|p| length(p) < 0.97) == [true; 2];
                    let are_flat = [i, j].map(|p| length(p) > 0.99) == [true; 2];
                    if apart < 0.2 && if edges { are_edges } else { are_flat } {
                        squares += f64::from(light[i] - light[j]).powi(2);
                    }
                }
            }
            squares
        };
        let (before, after) = (noise(&plain), noise(&smooth));
        assert!(before > 0.0 && after < 0.1 * before, "edges {edges}: {before} to {after}");
    }
}

/// The foot of a wall that gets light from the floor before it alone: near the corner half of what it sees is floor, and most
/// of that is nearer than the photon map's disc.
#[test]
fn a_corner_is_neither_dark_nor_bright() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("corner.toml");
    let mut model = Model::default();
    let lamp = 30.0;
    model.object("floor");
    model.material("floor");
    model.quad([[0.0, -3.0, 0.0], [6.0, -3.0, 0.0], [6.0, 3.0, 0.0], [0.0, 3.0, 0.0]]);
    model.object("wall");
    model.material("wall");
    model.quad([[0.0, -3.0, 0.0], [0.0, 3.0, 0.0], [0.0, 3.0, 3.0], [0.0, -3.0, 3.0]]);
    model.write(
        &dir.path().join("corner.obj"),
        "newmtl floor\nKd 0.6 0.6 0.6\nnewmtl wall\nKd 0.02 0.02 0.02\n",
    );
    // The lamp is in the plane of the wall, and shines along it.
    std::fs::write(
        &scene,
        format!(
            "[[mesh]]\nfile = \"corner.obj\"\n[[light]]\nkind = \"point\"\nposition = [0.001, 0, {lamp}]\nwatts = 90000\n\
             [[view]]\nname = \"foot\"\neye = [1, 0, 0.3]\ntarget = [0, 0, 0.06]\nfov = 3\nwidth = 32\nheight = 32\n"
        ),
    )
    .unwrap();
    let store = light(&scene, "1000k", &[]);
    let flags = ["--samples", "4", "--max-samples", "4"];
    let gather = [&GATHER[..], &flags[..], &["--gather-rays", "64"]].concat();
    let found = mean(&render(&store, dir.path(), "g", "foot", &gather), "indirect.G");
    let plain = mean(&render(&store, dir.path(), "p", "foot", &flags), "indirect.G");
    // The integral over the floor, in steps that grow with the distance.
    let (z, n) = (0.06, 600);
    let mut received = 0.0;
    let step =
        |i: i32, end: f64| 1e-4 * ((1.0 + end / 1e-4).powf(f64::from(i) / f64::from(n)) - 1.0);
    for i in 0..n {
        let (x0, x1) = (step(i, 6.0), step(i + 1, 6.0));
        for j in 0..n {
            let (y0, y1) = (step(j, 3.0), step(j + 1, 3.0));
            let (x, y) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
            let far: f64 = x * x + y * y + lamp * lamp;
            let near: f64 = x * x + y * y + z * z;
            let lit = 90_000.0 / (4.0 * PI) * lamp / (far * far.sqrt());
            received += 2.0 * lit * x * z / (PI * near * near) * (x1 - x0) * (y1 - y0);
        }
    }
    let expected = received * 0.6 * 0.02 / PI;
    // 65,536 rays of which half meet the floor: deviation 0.4 %. The picture shows 5 cm of the wall, over which the integral
    // is straight to a per cent.
    assert!((found / expected - 1.0).abs() < 0.03, "{found} for {expected}");
    assert!(plain < 0.9 * expected, "a photon map alone is dark there: {plain} for {expected}");
}

/// A plate above a floor that a lamp far above lights: what its underside gets from the floor is an integral.
#[test]
fn a_form_factor() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("plate.toml");
    let mut model = Model::default();
    let (half, height, lamp, small) = (3.0, 2.0, 30.0, 0.2);
    model.object("floor");
    model.material("floor");
    model.quad([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]]);
    model.object("plate");
    model.material("plate");
    let s = small;
    model.quad([[-s, -s, height], [-s, s, height], [s, s, height], [s, -s, height]]);
    model.write(
        &dir.path().join("plate.obj"),
        "newmtl floor\nKd 0.6 0.5 0.4\nnewmtl plate\nKd 0.5 0.5 0.5\n",
    );
    std::fs::write(
        &scene,
        format!(
            "[[mesh]]\nfile = \"plate.obj\"\n[[light]]\nkind = \"point\"\nposition = [0, 0, {lamp}]\nwatts = 90000\n\
             [[view]]\nname = \"below\"\neye = [0, 0, 1]\ntarget = [0, 0, 2]\nup = [0, 1, 0]\nfov = 20\nwidth = 48\nheight = 48\n"
        ),
    )
    .unwrap();
    let store = light(&scene, "20k", &[]);
    let flags = ["--samples", "4", "--gather-rays", "32", "--max-samples", "4"];
    let picture = render(&store, dir.path(), "out", "below", &[&GATHER[..], &flags[..]].concat());
    let seen = render(&store, dir.path(), "direct", "below", &["--indirect", "none"]);
    assert_eq!(mean(&seen, "G"), 0.0, "no lamp is seen from below");
    // Irradiance under the middle of the plate, by a fine grid over the floor; the plate's own shadow is dark.
    let n = 1000;
    let mut received = 0.0;
    for i in 0..n {
        for j in 0..n {
            let at = |k: i32| -half + 2.0 * half * (f64::from(k) + 0.5) / f64::from(n);
            let (x, y): (f64, f64) = (at(i), at(j));
            let shade = s * lamp / (lamp - height);
            if x.abs() < shade && y.abs() < shade {
                continue;
            }
            let (far, near) = (x * x + y * y + lamp * lamp, x * x + y * y + height * height);
            let lit = 90_000.0 / (4.0 * PI) * lamp / (far * far.sqrt());
            received += lit * height * height / (PI * near * near);
        }
    }
    received *= (2.0 * half / f64::from(n)).powi(2);
    for (channel, floor) in [("indirect.R", 0.6), ("indirect.G", 0.5), ("indirect.B", 0.4)] {
        let expected = received * floor * 0.5 / PI;
        let found = mean(&picture, channel);
        // 73,728 rays of which two thirds meet the floor: deviation 0.3 %. The picture shows 35 cm of the plate, over which
        // the integral falls by less than 0.5 %.
        assert!((found / expected - 1.0).abs() < 0.015, "{channel}: {found} for {expected}");
    }
}

/// Two rooms with a doorway, a mirror and a pane: gathering agrees with a photon map of very many photons, and does
/// not depend on how many it has itself.
#[test]
fn gathered_light_is_what_many_photons_say() {
    let dir = tempfile::tempdir().unwrap();
    common::furnished(dir.path());
    let scene = dir.path().join("rooms.toml");
    let flags = ["--width", "80", "--height", "60", "--samples", "8"];
    let gather = [&GATHER[..], &flags[..]].concat();
    let store = light(&scene, "400k", &[]);
    let mut means = Vec::new();
    for view in ["door", "hall"] {
        let many = mean(&render(&store, dir.path(), "m", view, &flags), "indirect.G");
        means.push((many, mean(&render(&store, dir.path(), "g", view, &gather), "indirect.G")));
    }
    let store = light(&scene, "30k", &[]);
    for (view, (many, gathered)) in ["door", "hall"].into_iter().zip(means) {
        let few = mean(&render(&store, dir.path(), "f", view, &gather), "indirect.G");
        // Edges and corners, of which there are many here, make the map some per cent too dark.
        assert!((gathered / many - 1.03).abs() < 0.05, "{view}: {gathered}, {many} by photons");
        // From afar the map still shows what its discs lose at edges: more, the wider they are.
        let lost = few / gathered - 0.95;
        assert!(lost.abs() < 0.06, "{view}: {few} from few, {gathered} from many");
    }
}

/// Gather rays, further samples, and rays that start in many tiles: the same bits whatever the threads, the budget and the tiles.
#[test]
fn the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let scene = common::furnished(dir.path());
    let mut seen: Option<Vec<Vec<u8>>> = None;
    let variants: [(&[&str], &[&str]); 3] = [
        (&["--memory", "64M"], &["--memory", "64M", "--threads", "1"]),
        (&["--memory", "4G"], &["--memory", "4G", "--threads", "2"]),
        (
            &["--tile-triangles", "300"],
            &[
                "--threads",
                "2",
                "--queue-rows",
                "3",
                "--queue-block",
                "200",
                "--resident-rooms",
                "1",
            ],
        ),
    ];
    for (i, (partition, later)) in variants.into_iter().enumerate() {
        let store = light(&scene, "3k", partition);
        let out = dir.path().join(format!("out-{i}"));
        ok(bin("enf-render")
            .arg(&store)
            .arg("-o")
            .arg(&out)
            .args(["--quiet", "--view", "door", "--view", "plan:0", "--view", "panorama:1"])
            .args(["--width", "96", "--height", "64", "--samples", "4", "--noise", "0.05"])
            .args(["--stats"])
            .arg(dir.path().join("stats.json"))
            .args(GATHER)
            .args(later));
        let stats = json(&dir.path().join("stats.json"));
        let first = 3.0 * 96.0 * 64.0 * 4.0;
        let all = number(&stats, "rays_camera");
        assert!(all > 1.05 * first && all < 6.0 * first, "{all} rays");
        let files = ["door.exr", "door.png", "plan-0.exr", "panorama-1.exr"];
        let bytes: Vec<_> = files.iter().map(|f| std::fs::read(out.join(f)).unwrap()).collect();
        match &seen {
            None => seen = Some(bytes),
            Some(seen) => assert!(*seen == bytes, "variant {i} makes other pictures"),
        }
    }
}

/// Two views of three bands, with one tile in memory or all of them, with a table that is full at once or never, and killed on the way:
/// the same bits. Bands are under way together, and their rays lie in one log.
#[test]
fn bands_that_are_under_way_together() {
    let dir = tempfile::tempdir().unwrap();
    let scene = common::furnished(dir.path());
    let small = ["--queue-rows", "3", "--queue-block", "200", "--resident-rooms", "1"];
    let roomy = ["--memory", "1G"];
    let tight = ["--memory", "56M"];
    let variants: [(&[&str], &[&str], &str, bool); 5] = [
        (&[], &roomy, "1", false),
        (&[], &tight, "4", false),
        (&["--tile-triangles", "300"], &small, "2", false),
        (&["--tile-triangles", "300"], &small, "4", true),
        (&[], &["--schedule", "most-work"], "2", false),
    ];
    let mut seen: Option<(Vec<Vec<u8>>, Value)> = None;
    for (i, (partition, flags, threads, killed)) in variants.into_iter().enumerate() {
        let store = light(&scene, "3k", partition);
        let out = dir.path().join(format!("out-{i}"));
        let stats = dir.path().join("stats.json");
        let command = || {
            let mut command = bin("enf-render");
            command.arg(&store).arg("-o").arg(&out).arg("--stats").arg(&stats);
            command.args(["--quiet", "--all-rooms", "--view", "door", "--view", "hall"]);
            command.args(["--width", "224", "--height", "160", "--samples", "4"]);
            command.args(["--noise", "0.3", "--formats", "exr", "--threads", threads]);
            command.args(flags);
            command
        };
        if killed {
            let mut child = command().spawn().unwrap();
            // Until a band is written; the others are then on their way.
            while child.try_wait().unwrap().is_none() && !is_a_band_written(&store) {
                std::thread::sleep(std::time::Duration::from_millis(2));
            }
            let _ = child.kill();
            child.wait().unwrap();
        }
        ok(&mut command());
        let stats = json(&stats);
        let bytes: Vec<_> =
            ["door.exr", "hall.exr"].iter().map(|f| std::fs::read(out.join(f)).unwrap()).collect();
        let Some((pictures, first)) = &seen else {
            seen = Some((bytes, stats));
            continue;
        };
        assert!(*pictures == bytes, "variant {i} makes other pictures");
        if !killed {
            for key in ["rays_camera", "rays_shadow", "rays_gather", "light_outside_sets_share"] {
                assert_eq!(number(&stats, key), number(first, key), "variant {i}: {key}");
            }
        }
        // One that was killed may have had little left to do.
        if !partition.is_empty() && !killed {
            assert!(number(&stats, "table.spilled_blocks") > 0.0, "the table was never full");
        }
    }
}

/// Gathered light is averaged across the edges of bands, and of those of an earlier run: killed on the way once a band is written,
/// with one thread or several, in little memory or much, the same bits.
#[test]
fn bands_that_are_smoothed_together() {
    let dir = tempfile::tempdir().unwrap();
    let store = light(&common::furnished(dir.path()), "3k", &[]);
    let mut seen: Option<Vec<u8>> = None;
    // Where one tile is in memory and the busiest comes first, bands end that wait for others, whose rays wait for a tile to be loaded.
    let few: &[&str] = &["--schedule", "most-work", "--resident-rooms", "1"];
    for (i, (memory, threads, killed, flags)) in [
        ("1G", "2", false, &[][..]),
        ("72M", "1", false, &[]),
        ("1G", "4", true, &[]),
        ("1G", "1", true, &[]),
        ("1G", "2", false, few),
        ("72M", "1", false, few),
    ]
    .into_iter()
    .enumerate()
    {
        let out = dir.path().join(format!("hall-{i}.exr"));
        // Four bands and a bit.
        let command = |force: bool| {
            let mut command = bin("enf-render");
            command.arg(&store).arg("-o").arg(&out).args(GATHER);
            command.args(["--quiet", "--all-rooms", "--view", "hall", "--samples", "2"]);
            command.args(["--width", "512", "--height", "272", "--gather-rays", "2"]);
            command.args(["--memory", memory, "--threads", threads]).args(flags);
            command.args(force.then_some("--force"));
            command
        };
        if killed {
            common::files_of(&store).iter().filter(|f| f.starts_with("render.")).for_each(|f| {
                std::fs::remove_file(store.join(f)).unwrap();
            });
            let mut child = command(false).spawn().unwrap();
            while child.try_wait().unwrap().is_none() && !is_a_band_written(&store) {
                std::thread::sleep(std::time::Duration::from_millis(2));
            }
            let _ = child.kill();
            child.wait().unwrap();
        }
        ok(&mut command(!killed));
        let bytes = std::fs::read(&out).unwrap();
        assert!(*seen.get_or_insert_with(|| bytes.clone()) == bytes, "variant {i}");
    }
}

/// Whether a band of a picture is written.
fn is_a_band_written(store: &Path) -> bool {
    let found = StoreDir::open(store)
        .and_then(|store| StageReader::open_unsealed(&store, StageKind::Render))
        .map(|reader| !reader.find(ExtentKind::Film, 0).is_empty());
    found.unwrap_or(false)
}

/// A plan and a panorama of two rooms: depths are heights below the cut and distances to walls, and rooms are where they are.
#[test]
fn plans_and_panoramas() {
    let dir = tempfile::tempdir().unwrap();
    let obj = dir.path().join("two.obj");
    common::two_rooms(&obj);
    let scene = dir.path().join("two.toml");
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"two.obj\"\n\
         [[view]]\nname = \"floor\"\nkind = \"plan\"\neye = [5.1, 2, 1.6]\nsize = 5\nwidth = 220\nheight = 100\n\
         [[view]]\nname = \"about\"\nkind = \"panorama\"\neye = [4, 2, 1.4]\ntarget = [5, 2, 1.4]\nwidth = 128\nheight = 64\n",
    )
    .unwrap();
    let store = light(&scene, "2k", &[]);
    let plan = render(&store, dir.path(), "o", "floor", &["--samples", "2"]);
    let at = |picture: &Loaded, channel: &str, x: u32, y: u32| {
        picture.channel(channel).unwrap()[(y * picture.width + x) as usize]
    };
    assert_eq!((plan.width, plan.height), (220, 100));
    // 5 cm a pixel; x = 0 at pixel 8, y = 4 at pixel 10, north up. Floor at 1 m from the corner, and in the other room.
    let pixel = |x: f64, y: f64| (((x + 0.4) / 0.05) as u32, ((4.5 - y) / 0.05) as u32);
    let (a, b) = (pixel(0.7, 3.3), pixel(9.5, 0.7));
    let depth = |p: (u32, u32)| at(&plan, "depth.Z", p.0, p.1);
    assert!((depth(a) - 1.6).abs() < 1e-3 && (depth(b) - 1.6).abs() < 1e-3, "{}", depth(a));
    let table = pixel(1.7, 1.3);
    assert!((depth(table) - (1.6 - 0.72)).abs() < 1e-3, "{}", depth(table));
    assert_ne!(at(&plan, "room.ID", a.0, a.1), at(&plan, "room.ID", b.0, b.1));
    // Walls are cut: black, and nothing behind.
    let wall = pixel(5.1, 1.0);
    assert_eq!((depth(wall), at(&plan, "G", wall.0, wall.1)), (0.0, 0.0));
    let about = render(&store, dir.path(), "o", "about", &["--samples", "4"]);
    // Straight ahead is the doorway, and the far wall beyond; to the right is the south wall, behind the west wall; below, the floor.
    for (x, y, expected) in
        [(64, 32, 6.2), (96, 32, 2.0), (32, 32, 2.0), (0, 32, 4.0), (64, 63, 1.4), (64, 0, 1.4)]
    {
        let depth = at(&about, "depth.Z", x, y);
        assert!((depth - expected).abs() < 0.02 * expected, "{depth} for {expected} at {x}, {y}");
    }
    // By flags, the same plan to the bit; coordinates are the model's.
    let out = dir.path().join("flags.exr");
    ok(bin("enf-render").arg(&store).arg("-o").arg(&out).args(["--quiet", "--force"]).args([
        "--eye",
        "5.1,2,1.6",
        "--projection",
        "plan",
        "--size",
        "5",
        "--width",
        "220",
        "--height",
        "100",
        "--samples",
        "2",
    ]));
    let flags = read_exr(&out).unwrap();
    assert!(flags.channels == plan.channels, "the same plan by flags");
    let text = fails(bin("enf-render").arg(&store).args(["--eye", "1,2,1.6"]), 2);
    assert!(text.contains("target"), "{text}");
}

/// A view that does not exist is refused before anything is computed, and those that exist are named.
#[test]
fn an_unknown_view_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let scene = common::furnished(dir.path());
    let out = dir.path().join("out");
    let text = fails(
        bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&out).args(["--view", "lobby"]),
        2,
    );
    assert!(text.contains("lobby") && text.contains("door") && text.contains("hall"), "{text}");
    assert!(!out.join("rooms.enf").exists(), "nothing was begun");
    std::fs::write(
        dir.path().join("v.toml"),
        "[[view]]\nname = \"lobby\"\neye = [1,1,1]\nkind = \"x\"\n",
    )
    .unwrap();
    let text = fails(
        bin("enfilade")
            .arg("run")
            .arg(&scene)
            .arg("-o")
            .arg(&out)
            .args(["--view", "lobby", "--views"])
            .arg(dir.path().join("v.toml")),
        4,
    );
    assert!(text.contains("v.toml") && text.contains("perspective, panorama and plan"), "{text}");
}

/// Light through a hole of 5 cm, too small to be an opening: no photon and no probe has found the way, so it is of a lamp outside
/// the room's set. It falls on a spot on the far wall that a lamp of the room lights as well: which share is whose is a matter of
/// intensities and distances.
#[test]
fn light_from_outside_the_set_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let mut m = Model::default();
    m.object("walls");
    m.material("white");
    for (min, max) in [
        ([-8.2, -2.2, -0.2], [4.2, 2.2, 0.0]),
        ([-8.2, -2.2, 3.0], [4.2, 2.2, 3.2]),
        ([-8.2, -2.2, 0.0], [4.2, -2.0, 3.0]),
        ([-8.2, 2.0, 0.0], [4.2, 2.2, 3.0]),
        ([-8.2, -2.0, 0.0], [-8.0, 2.0, 3.0]),
        ([4.0, -2.0, 0.0], [4.2, 2.0, 3.0]),
        // The wall between the rooms, 1 cm thick, about the hole.
        ([0.0, -2.0, 0.0], [0.01, -0.025, 3.0]),
        ([0.0, 0.025, 0.0], [0.01, 2.0, 3.0]),
        ([0.0, -0.025, 0.0], [0.01, 0.025, 1.475]),
        ([0.0, -0.025, 1.525], [0.01, 0.025, 3.0]),
    ] {
        m.cuboid(min, max, false);
    }
    m.write(&dir.path().join("hole.obj"), "newmtl white\nKd 0.5 0.5 0.5\n");
    let scene = dir.path().join("hole.toml");
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"hole.obj\"\n\
         [[light]]\nkind = \"point\"\nposition = [-4, 0, 1.5]\ncandela = 400\n\
         [[light]]\nkind = \"point\"\nposition = [2, 0, 2.5]\ncandela = 20\n\
         [[view]]\nname = \"spot\"\neye = [1, 0, 1.5]\ntarget = [4, 0, 1.5]\nfov = 0.8\n",
    )
    .unwrap();
    let store = light(&scene, "20", &[]);
    let sets = StageReader::open(&StoreDir::open(&store).unwrap(), StageKind::Trace).unwrap();
    let counts: Vec<u64> = (0..2)
        .map(|room| sets.find(ExtentKind::LightSet, room).iter().map(|e| e.count).sum())
        .collect();
    assert_eq!(counts, [1, 1], "each room knows its own lamp");
    // 32 x 32 pixels of 4.2 cm, the spot being 10 cm wide; one shadow ray in a hundred goes to the lamp outside.
    let flags = ["--width", "32", "--height", "32", "--samples", "128", "--max-samples", "128"];
    let flags = [&flags[..], &["--indirect", "none"]].concat();
    let picture = render(&store, dir.path(), "spot", "spot", &flags);
    // Candela times the cosine over the square: 400 / 8^2 head-on; 20 / (2^2 + 1^2) at a cosine of 2 / sqrt 5.
    let (outside, own) = (400.0 / 64.0, 20.0 / 5.0 * 2.0 / 5f64.sqrt());
    let share = outside / (outside + own);
    let found = number(&json(&dir.path().join("render.json")), "light_outside_sets_share");
    // Some 2,600 of 262,144 shadow rays go through the hole: their sum is off by 2 %, the share by 0.8 of a hundred.
    assert!((found - share).abs() < 0.035, "{found} for {share}");
    // Radiance: a reflectance of 0.5, and candela are lumens a steradian at 179 lumens a watt.
    let wanted = 0.5 / PI * (outside + own) / 179.0;
    let mean = mean(&picture, "G");
    assert!((mean / wanted - 1.0).abs() < 0.06, "{mean} for {wanted}");
}

/// `--force` makes the same picture anew; without it nothing is done, and the files are as they were either way.
#[test]
fn force_renders_anew() {
    let dir = tempfile::tempdir().unwrap();
    let scene = common::furnished(dir.path());
    let store = light(&scene, "2k", &[]);
    let mut seen: Option<Vec<u8>> = None;
    for (force, made) in [(false, true), (false, false), (true, true), (false, false), (true, true)]
    {
        let (stats, out) = (dir.path().join("s.json"), dir.path().join("door.exr"));
        let mut command = bin("enf-render");
        command.arg(&store).arg("-o").arg(&out).arg("--stats").arg(&stats);
        command.args(["--quiet"]).args(common::PICTURE);
        if force {
            command.arg("--force");
        }
        ok(&mut command);
        assert_eq!(number(&json(&stats), "rays_camera") > 0.0, made, "force {force}");
        let bytes = std::fs::read(&out).unwrap();
        assert!(*seen.get_or_insert_with(|| bytes.clone()) == bytes, "force {force}");
    }
}

/// All files of a picture, read back: they show the same light. Another view of a finished store leaves them alone.
#[test]
fn files_that_people_open() {
    let dir = tempfile::tempdir().unwrap();
    let scene = common::furnished(dir.path());
    let store = light(&scene, "2k", &[]);
    let out = dir.path().join("out");
    let render = |view: &str, more: &[&str]| {
        let mut command = bin("enf-render");
        command.arg(&store).arg("-o").arg(&out).args(["--quiet", "--view", view]);
        command.args(["--width", "40", "--height", "30", "--samples", "2"]).args(more);
        common::stdout(&ok(&mut command))
    };
    let all = ["--formats", "png,exr,hdr,falsecolour", "--exposure", "ev:6", "--tone", "linear"];
    let printed = render("door", &all);
    let files = ["door.png", "door.exr", "door.hdr", "door.falsecolour.png"];
    assert_eq!(printed.lines().count(), 4);
    let bytes = |f: &str| std::fs::read(out.join(f)).unwrap();
    let before: Vec<_> = files.iter().map(|f| bytes(f)).collect();

    let exr = read_exr(&out.join("door.exr")).unwrap();
    let names = ["R", "direct.R", "indirect.R", "albedo.R", "normal.X", "depth.Z", "room.ID"];
    for name in names {
        assert!(exr.channel(name).is_some(), "{name} is among {:?}", exr.channels.keys());
    }
    for (i, &sum) in exr.channel("G").unwrap().iter().enumerate() {
        let parts = exr.channel("direct.G").unwrap()[i] + exr.channel("indirect.G").unwrap()[i];
        assert!((sum - parts).abs() <= 1e-5 * sum.abs(), "{sum} is {parts}");
    }
    // The picture's mean brightness in the linear PNG is that of the radiance, cut off at white.
    let decoder = png::Decoder::new(std::io::Cursor::new(bytes("door.png")));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let shown: f64 = pixels
        .chunks(3)
        .map(|p| {
            let v = f64::from(p[1]) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        })
        .sum();
    let factor = 179.0 / (1.2 * 64.0);
    let linear: f64 =
        exr.channel("G").unwrap().iter().map(|&g| (f64::from(g) * factor).min(1.0)).sum();
    assert!((shown / linear - 1.0).abs() < 0.02, "{shown} for {linear}");
    let hdr = bytes("door.hdr");
    assert!(hdr.starts_with(b"#?RADIANCE"));
    assert!(hdr.windows(12).any(|w| w == b"-Y 30 +X 40\n"));
    let decoder = png::Decoder::new(std::io::Cursor::new(bytes("door.falsecolour.png")));
    let info = decoder.read_info().unwrap();
    assert!(info.info().width > 40, "it has a legend beside it");

    // Another view: no --force, and the first one's files stay as they are.
    render("hall", &[]);
    assert!(out.join("hall.exr").exists());
    let after: Vec<_> = files.iter().map(|f| bytes(f)).collect();
    assert!(before == after, "the first view's files are as they were");
    // Once more the first, under its own names, would change nothing: but its film is gone, and that is said.
    let text = fails(
        bin("enf-render").arg(&store).arg("-o").arg(&out).args(["--quiet", "--view", "door"]),
        2,
    );
    assert!(text.contains("--force"), "{text}");
}

/// Views that are not the same picture are not one, however they are called.
#[test]
fn views_with_one_name_are_two_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(common::furnished(dir.path())).unwrap();
    let view = |name: &str, eye: &str| {
        format!("\n[[view]]\nname = \"{name}\"\neye = {eye}\ntarget = [2.0, 2.0, 1.0]\n")
    };
    let scene = dir.path().join("named.toml");
    let views = view("a+b", "[1.0, 1.0, 1.5]") + &view("a-b", "[1.5, 1.0, 1.5]");
    let views = views + &view("camera", "[1.2, 1.0, 1.5]");
    std::fs::write(&scene, text + &views).unwrap();
    let store = light(&scene, "1k", &[]);
    let out = dir.path().join("o");
    let flags = ["--samples", "1", "--width", "8", "--height", "8", "--formats", "png", "--quiet"];
    let names = |more: &[&str]| {
        let _ = std::fs::remove_dir_all(&out);
        let said = ok(bin("enf-render").arg(&store).arg("-o").arg(&out).args(flags).args(more));
        let printed = common::stdout(&said);
        let mut names: Vec<_> =
            printed.lines().map(|l| l.rsplit('/').next().unwrap().to_owned()).collect();
        for name in &names {
            assert!(out.join(name).exists(), "{name}");
        }
        names.sort();
        names
    };
    let eye = ["--eye", "1.1,1,1.5", "--target", "2,2,1"];
    let all = names(&[&eye[..], &["--view", "all"]].concat());
    for name in ["a-b.png", "a-b-2.png", "camera.png", "camera-2.png"] {
        assert_eq!(all.iter().filter(|n| *n == name).count(), 1, "{name} in {all:?}");
    }
    let twice = names(&["--view", "camera", "--view", "camera"]);
    assert_eq!(twice, ["camera.png"], "the same picture twice is one");
}
