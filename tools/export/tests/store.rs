//! A store is the same building as the scene that it was made from.

use std::path::{Path, PathBuf};

use clap::Parser;
use enf_export::building::Building;
use enf_export::{mitsuba, radiance, view};
use enf_scene::LoadOptions;
use enf_stage::IdSink;

fn store_of(scene: &Path, folder: &Path) -> PathBuf {
    let store = folder.join("scene.enf");
    let flags = ["--quiet", "--rooms", "4", "-o"];
    let mut line = vec!["enf-partition".into(), scene.as_os_str().to_owned()];
    line.extend(flags.map(Into::into));
    line.push(store.clone().into_os_string());
    let cli = enf_partition::Cli::try_parse_from(line).unwrap();
    enf_partition::run(&cli, &IdSink::nowhere()).unwrap();
    store
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap())
        .map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap()))
        .collect();
    all.sort();
    all
}

#[test]
fn what_is_written_of_a_store_is_what_is_written_of_its_scene() {
    for name in ["two-rooms.toml", "gallery.toml", "studio.toml"] {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes");
        let folder = tempfile::tempdir().unwrap();
        let options = LoadOptions::default();
        let scene = Building::read(&scenes.join(name), &options).unwrap();
        let store = store_of(&scenes.join(name), folder.path());
        let store = Building::read(&store, &options).unwrap();
        assert_eq!(store.triangles, scene.triangles, "{name}");
        assert_eq!(store.views, scene.views, "{name}");
        for (building, to) in [(&scene, "of-scene"), (&store, "of-store")] {
            let views = view::chosen(&building.views, &[], None, None).unwrap();
            mitsuba::write(building, &views, &folder.path().join(to)).unwrap();
            radiance::write(building, &views, &folder.path().join(to)).unwrap();
        }
        let (of_scene, of_store) =
            (files(&folder.path().join("of-scene")), files(&folder.path().join("of-store")));
        assert!(of_scene.len() > 4);
        for (a, b) in of_scene.iter().zip(&of_store) {
            assert_eq!(a.0, b.0, "{name}");
            assert!(a.1 == b.1, "{name}: {} differs", a.0);
        }
        assert_eq!(of_scene.len(), of_store.len(), "{name}");
    }
}
