//! Frozen bytes: one value of every record, as it must look on the disk for as long as the format
//! version stands; and the format document, held against the definitions.
//!
//! Every field of a value has bytes of its own, so that two fields that change places are seen.
//! A failure here means that stores written before would be read wrongly. If that is meant: raise
//! `FORMAT_VERSION`, correct docs/FORMAT.md, and write the fixtures anew with `ENF_BLESS=1`.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::mem::offset_of;
use std::path::PathBuf;

use enf_layout::bsp::{
    FACE_IN_FRONT, FaceRecord, LEAF, LEAF_OUTSIDE, LEAF_SOLID, LeafRecord, NodeRecord, PlaneRecord,
};
use enf_layout::bvh::{BvhHeader, BvhNode, LeafBlock};
use enf_layout::film::PixelRecord;
use enf_layout::grid::{BrickRecord, GridHeader};
use enf_layout::journal::{
    JournalKind, JournalRecord, LedgerRecord, LightPairRecord, PassageRecord,
};
use enf_layout::light::{
    EmitterRecord, LIGHT_AREA, LIGHT_POINT, LIGHT_POINT_LAMBERT, LIGHT_PROFILE, LIGHT_SKY,
    LIGHT_SPOT, LIGHT_SUN, LightRecord,
};
use enf_layout::map::{
    BLOCK_PHOTONS, MapBlock, MapHeader, MapNode, NO_PHOTON, NODE_CHILDREN, PIECE_PHOTONS,
};
use enf_layout::material::{
    MATERIAL_GLOSS, MATERIAL_ONE_SIDED_EMITTER, MATERIAL_SEE_THROUGH, MATERIAL_SOLID,
    MaterialRecord,
};
use enf_layout::photon::*;
use enf_layout::profile::ProfileRecord;
use enf_layout::room::{
    PIECE_CORNERS, PortalPieceRecord, PortalRecord, RoomRecord, SceneRecord, TileRecord, ViewRecord,
};
use enf_layout::sections::{SECTIONS_MAGIC, SectionRecord, SectionsHeader, Transform, build};
use enf_layout::segment::*;
use enf_layout::sky::SkyRecord;
use enf_layout::texture::*;
use enf_layout::transit::*;
use enf_layout::{FORMAT_VERSION, NONE, codec, octahedral, rgbe};
use zerocopy::IntoBytes;

const REMEDY: &str = "stores written before would be read wrongly. If that is meant: raise FORMAT_VERSION in \
     crates/layout/src/lib.rs, correct docs/FORMAT.md, and write the fixtures anew with \
     ENF_BLESS=1 cargo test -p enf-layout --test golden";

/// One record type: its bytes, and where its fields are.
struct Golden {
    name: &'static str,
    bytes: Vec<u8>,
    fields: Vec<(&'static str, usize)>,
}

macro_rules! golden {
    ($($record:ident { $($field:ident : $value:expr),* $(,)? })*) => {
        vec![$(Golden {
            name: stringify!($record),
            bytes: $record { $($field: $value),* }.as_bytes().to_vec(),
            fields: vec![$((stringify!($field), offset_of!($record, $field))),*],
        }),*]
    };
}

/// 16 bytes from `first` on.
fn run(first: u8) -> [u8; 16] {
    std::array::from_fn(|i| first + i as u8)
}

/// One value of every record.
fn records() -> Vec<Golden> {
    golden! {
        FileHeader {
            magic: SEGMENT_MAGIC,
            version: FORMAT_VERSION,
            stage: StageKind::Trace as u32,
            process: 7,
            segment: 3,
            record_size: 96,
            reserved: 0,
            made_from: run(0x10),
            reserved2: [0; 8],
            checksum: 0x0123_4567_89ab_cdef,
        }
        SealRecord {
            name: *b"trace.007.000.dat\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
            length: 1_000_001,
            hash: run(0x20),
        }
        JournalRecord {
            sequence: 5,
            kind: JournalKind::Extent as u32,
            extent_kind: ExtentKind::Photons as u32,
            id: 12,
            segment: 0,
            codec: Codec::ZstdPlanes as u32,
            process: 7,
            offset: 4096,
            stored_bytes: 2400,
            raw_bytes: 4800,
            count: 200,
            data_checksum: run(0x30),
            reserved2: 0,
            checksum: 0xfedc_ba98_7654_3210,
        }
        LedgerRecord {
            room: 3,
            reserved: 0,
            emitted: 20_000,
            absorbed: 19_000,
            escaped: 1_000,
            stored: 40_000,
            emitted_w: [1.0, 2.0, 3.0],
            absorbed_w: [4.0, 5.0, 6.0],
            escaped_w: [7.0, 8.0, 9.0],
            reflections_sum: 41_000,
            reflections_min: 1,
            reflections_max: 17,
        }
        PassageRecord { from: 1, to: 2, photons: 333, flux_w: 4.5 }
        LightPairRecord { room: 5, light: 6, photons: 777, emitted: 20_000 }
        SectionsHeader { magic: SECTIONS_MAGIC, count: 4 }
        SectionRecord { offset: 128, bytes: 36, transform: Transform::Delta as u32, stride: 3 }
        PlaneRecord { normal: [0.6, 0.0, 0.8], offset: -2.5 }
        NodeRecord { plane: 6, front: 1, back: LEAF | 2, cut: 1 }
        LeafRecord {
            room: 4,
            tile: 5,
            first_face: 6,
            face_count: 7,
            flags: LEAF_OUTSIDE,
            reserved: 0,
        }
        FaceRecord { plane: FACE_IN_FRONT | 6, beyond: NONE }
        SceneRecord {
            origin: [100.0, 200.0, 300.0],
            bounds_min: [-1.0, -2.0, -3.0],
            bounds_max: [4.0, 5.0, 6.0],
            delta: 1.0 / 8192.0,
            reserved: 0,
            triangles: 336_500,
            stored_triangles: 350_000,
            geometry_digest: run(0x40),
            rooms: 28,
            outside: 27,
            largest_tile_bytes: 1 << 20,
        }
        RoomRecord {
            min: [0.0, 1.0, 2.0],
            max: [3.0, 4.0, 5.0],
            inside: [1.5, 2.5, 3.5],
            volume_m3: 27.0,
            floor_area_m2: 9.0,
            flags: LEAF_OUTSIDE,
            triangles: 12_000,
            first_portal: 8,
            portal_count: 9,
            first_tile: 10,
            tile_count: 11,
        }
        PortalRecord {
            room: 1,
            other: 2,
            first_piece: 3,
            piece_count: 4,
            area_m2: 1.89,
            centre: [5.0, 6.0, 7.0],
        }
        PortalPieceRecord {
            corners: [
                [0.0, 1.0, 2.0],
                [3.0, 4.0, 5.0],
                [6.0, 7.0, 8.0],
                [9.0, 10.0, 11.0],
                [0.0; 3],
                [0.0; 3],
                [0.0; 3],
                [0.0; 3],
            ],
            count: 4,
            area_m2: 1.5,
            reserved: [0; 2],
        }
        TileRecord {
            room: 1,
            first_light: 2,
            light_count: 3,
            reserved: 0,
            triangles: 1234,
            mesh_bytes: 56_789,
            min: [0.5, 1.5, 2.5],
            max: [3.5, 4.5, 5.5],
        }
        ViewRecord {
            eye: [1.0, 2.0, 1.6],
            target: [4.0, 5.0, 1.4],
            up: [0.0, 0.0, 1.0],
            fov_degrees: 58.0,
            width: 960,
            height: 600,
        }
        MaterialRecord {
            diffuse: [0.25, 0.5, 0.75],
            specular: [0.1, 0.2, 0.3],
            transmission: [0.4, 0.45, 0.475],
            emission: [10.0, 20.0, 30.0],
            absorption: [7.0, 8.0, 9.0],
            index: 1.5,
            roughness: 0.0625,
            light_area_m2: 0.35,
            flags: MATERIAL_SEE_THROUGH | MATERIAL_SOLID,
            texture: 3,
        }
        TextureRecord {
            first_texel: 4096,
            width: 64,
            height: 32,
            flags: TEXTURE_CLAMP_X | TEXTURE_MIRROR_Y,
            place: [[1.0, 0.125, 0.25], [-0.5, -1.0, 1.0]],
            mean: [0.2, 0.3, 0.4],
            reserved: 0,
        }
        LightRecord {
            kind: LIGHT_POINT_LAMBERT,
            material: NONE,
            first_emitter: 1,
            emitter_count: 2,
            flux_w: [3.0, 4.0, 5.0],
            area_m2: 0.36,
            position: [6.0, 7.0, 8.0],
            radius: 0.5,
            axis: [0.0, 0.0, -1.0],
            profile: 3,
            tangent: [1.0, 0.0, 0.0],
            cone: [0.875, 0.75],
            reserved: [0; 3],
        }
        EmitterRecord {
            corners: [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]],
            triangle: 99,
            cumulative: 0.5,
            reserved: 0,
        }
        ProfileRecord {
            first_value: 11,
            rows: 37,
            columns: 73,
            folds: 2,
            origin: 1.5,
            peak: 0.75,
            lumens: 9561.0,
            reserved: 0,
        }
        SkyRecord {
            scale: 12.5,
            gradation: [-1.0, -0.32, 0.5],
            indicatrix: [0.75, 10.0, -3.0, 0.45],
            sun: [0.0, 0.6, 0.8],
            sun_radius: 0.0046513,
            sun_irradiance: [400.0, 500.0, 600.0],
            color: [0.25, 1.0, 4.0],
            ground: [7.0, 8.0, 9.0],
        }
        GridHeader {
            min: [-1.0, -2.0, -3.0],
            max: [1.0, 2.0, 3.0],
            cell: 0.125,
            delta: 1.0 / 8192.0,
            bricks: [4, 8, 12],
            triangles: 1000,
            cells: 500,
            references: 2000,
        }
        BrickRecord { mask: [0x0000_ffff, 0x8000_0000], first: 17 }
        BvhHeader { min: [-1.0, -2.0, -3.0], max: [1.0, 2.0, 3.0], delta: 1.0 / 8192.0, triangles: 9 }
        BvhNode {
            origin: [-1.0, -2.0, -3.0],
            step: [0.0078125, 0.015625, 0.03125],
            nodes: 1,
            blocks: 5,
            child: [0x80, 0x81, 0x60, 0xff, 0xff, 0xff, 0xff, 0xff],
            bounds: [
                [0, 10, 20, 255, 255, 255, 255, 255, 100, 110, 120, 0, 0, 0, 0, 0],
                [1, 11, 21, 255, 255, 255, 255, 255, 101, 111, 121, 0, 0, 0, 0, 0],
                [2, 12, 22, 255, 255, 255, 255, 255, 102, 112, 122, 0, 0, 0, 0, 0],
            ],
            used: 0b111,
            reserved: 0,
        }
        LeafBlock {
            corners: [
                [[0.0, 1.0, 2.0, 3.0]; 3],
                [[4.0, 5.0, 6.0, 7.0]; 3],
                [[8.0, 9.0, 10.0, 11.0]; 3],
            ],
            global: [7, 8, 9, 10],
            material: [0, 1, 0, 2],
        }
        PhotonRecord {
            position_bits: [1.0f32.to_bits(), 2.0f32.to_bits(), 3.0f32.to_bits()],
            flux: rgbe::encode([0.5, 0.25, 0.125], [0.0; 3]),
            directions: PhotonRecord::pack_directions(
                octahedral::encode([0.0, 0.6, -0.8]),
                octahedral::encode([0.0, 0.0, 1.0]),
            ),
            flags: PHOTON_CAUSTIC | PHOTON_HALO | 2,
        }
        TransitRecord {
            origin: [1.0, 2.0, 3.0],
            direction: [0.0, 0.6, 0.8],
            flux: [4.0, 5.0, 6.0],
            t: 7.5,
            leaf: 8,
            light: 9,
            photon: 10,
            bounce: 11,
            flags: TRANSIT_UNSCATTERED | TRANSIT_MIRRORED,
            last_triangle: 12,
            impacts: 13,
        }
        MapHeader { photons: 100_000, halo: 1234, radius: 0.6, piece: 2, pieces: 3, reserved: 0 }
        MapBlock {
            position_bits: std::array::from_fn(|axis| {
                std::array::from_fn(|i| (axis as f32 + i as f32 * 0.125).to_bits())
            }),
            flux: std::array::from_fn(|i| [i as u8, 100 + i as u8, 200 + i as u8, 128]),
            direction_flags: std::array::from_fn(|i| 0x0812_3400 + i as u32),
            normal_flags: std::array::from_fn(|i| 0x0056_7800 + i as u32),
        }
        MapNode {
            min: std::array::from_fn(|axis| std::array::from_fn(|i| (8 * axis + i) as f32)),
            max: std::array::from_fn(|axis| std::array::from_fn(|i| (100 + 8 * axis + i) as f32)),
        }
        PixelRecord {
            direct: [1.0, 2.0, 3.0],
            indirect: [4.0, 5.0, 6.0],
            albedo: [0.25, 0.5, 0.75],
            normal: [0.0, 0.6, 0.8],
            depth: 9.5,
            room: 13.0,
        }
    }
}

/// A blob with every transform, as it is and as it goes to zstd.
fn blobs() -> [(&'static str, Vec<u8>); 2] {
    let indices: Vec<u32> = (0..20u32).map(|i| i / 2 + 3 * (i % 2)).collect();
    let vertices: Vec<f32> = (0..9).map(|i| 1.0 + 0.125 * i as f32).collect();
    let blob = build(&[
        (indices.as_bytes(), Transform::Delta, 3),
        (vertices.as_bytes(), Transform::Xor, 3),
        (b"bytes", Transform::None, 0),
    ]);
    let mut planes = vec![0; blob.len()];
    codec::forward(&blob, &mut planes).unwrap();
    let mut back = planes.clone();
    let mut scratch = vec![0; codec::scratch_bytes(&planes).unwrap()];
    codec::inverse(&mut back, &mut scratch).unwrap();
    assert_eq!(back, blob);
    [("sections-blob", blob), ("sections-blob-planes", planes)]
}

/// Every number with a meaning.
fn numbers() -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: u64| writeln!(text, "{name} = {value}").unwrap();
    line("FORMAT_VERSION", FORMAT_VERSION.into());
    line("EXTENT_ALIGNMENT", EXTENT_ALIGNMENT);
    line("NONE", NONE.into());
    for (name, magic) in
        [("SEGMENT", SEGMENT_MAGIC), ("JOURNAL", JOURNAL_MAGIC), ("SEAL", SEAL_MAGIC)]
    {
        line(&format!("{name}_MAGIC"), u64::from_le_bytes(magic));
    }
    line("SECTIONS_MAGIC", SECTIONS_MAGIC.into());
    for n in 0..=255 {
        if let Some(stage) = StageKind::from_u32(n) {
            line(&format!("StageKind::{stage:?} ({})", stage.name()), n.into());
        }
    }
    for n in 0..=255 {
        if let Some(kind) = ExtentKind::from_u32(n) {
            line(&format!("ExtentKind::{kind:?}"), n.into());
        }
    }
    for n in 0..=255 {
        if let Some(codec) = Codec::from_u32(n) {
            line(&format!("Codec::{codec:?}"), n.into());
        }
    }
    for n in 0..=255 {
        if let Some(kind) = JournalKind::from_u32(n) {
            line(&format!("JournalKind::{kind:?}"), n.into());
        }
    }
    for transform in [Transform::None, Transform::Delta, Transform::Xor] {
        line(&format!("Transform::{transform:?}"), transform as u64);
    }
    for (name, value) in [
        ("LEAF", LEAF),
        ("LEAF_SOLID", LEAF_SOLID),
        ("LEAF_OUTSIDE", LEAF_OUTSIDE),
        ("FACE_IN_FRONT", FACE_IN_FRONT),
        ("LIGHT_AREA", LIGHT_AREA),
        ("LIGHT_POINT", LIGHT_POINT),
        ("LIGHT_POINT_LAMBERT", LIGHT_POINT_LAMBERT),
        ("LIGHT_SPOT", LIGHT_SPOT),
        ("LIGHT_PROFILE", LIGHT_PROFILE),
        ("LIGHT_SKY", LIGHT_SKY),
        ("LIGHT_SUN", LIGHT_SUN),
        ("MATERIAL_ONE_SIDED_EMITTER", MATERIAL_ONE_SIDED_EMITTER),
        ("MATERIAL_SEE_THROUGH", MATERIAL_SEE_THROUGH),
        ("MATERIAL_GLOSS", MATERIAL_GLOSS),
        ("MATERIAL_SOLID", MATERIAL_SOLID),
        ("TEXTURE_CLAMP_X", TEXTURE_CLAMP_X),
        ("TEXTURE_CLAMP_Y", TEXTURE_CLAMP_Y),
        ("TEXTURE_MIRROR_X", TEXTURE_MIRROR_X),
        ("TEXTURE_MIRROR_Y", TEXTURE_MIRROR_Y),
        ("PIECE_CORNERS", PIECE_CORNERS as u32),
        ("BLOCK_PHOTONS", BLOCK_PHOTONS as u32),
        ("NODE_CHILDREN", NODE_CHILDREN as u32),
        ("PIECE_PHOTONS", PIECE_PHOTONS as u32),
        ("NO_PHOTON", NO_PHOTON),
        ("PHOTON_DIRECT", PHOTON_DIRECT.into()),
        ("PHOTON_CAUSTIC", PHOTON_CAUSTIC.into()),
        ("PHOTON_BACK_SIDE", PHOTON_BACK_SIDE.into()),
        ("PHOTON_HALO", PHOTON_HALO.into()),
        ("TRANSIT_UNSCATTERED", TRANSIT_UNSCATTERED.into()),
        ("TRANSIT_MIRRORED", TRANSIT_MIRRORED.into()),
        ("TRANSIT_PROBE", TRANSIT_PROBE.into()),
        ("TRANSIT_CAMERA", TRANSIT_CAMERA.into()),
        ("TRANSIT_SHADOW", TRANSIT_SHADOW.into()),
        ("TRANSIT_AIMED", TRANSIT_AIMED.into()),
        ("TRANSIT_GATHER", TRANSIT_GATHER.into()),
        ("TRANSIT_ACROSS", TRANSIT_ACROSS.into()),
        ("TRANSIT_ALONG", TRANSIT_ALONG.into()),
    ] {
        line(name, value.into());
    }
    text
}

/// Every frozen file: name and contents.
fn files() -> Vec<(String, Vec<u8>)> {
    let mut list: Vec<_> =
        records().into_iter().map(|r| (format!("{}.bin", r.name), r.bytes)).collect();
    list.extend(blobs().map(|(name, bytes)| (format!("{name}.bin"), bytes)));
    list.push(("numbers.txt".into(), numbers().into_bytes()));
    list
}

/// The repository's root.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn bytes_are_as_they_were() {
    let dir = root().join("fixtures/golden");
    let bless = std::env::var_os("ENF_BLESS").is_some();
    // The frozen header knows which version the fixtures are of.
    let version = fs::read(dir.join("FileHeader.bin"))
        .ok()
        .and_then(|b| Some(u32::from_le_bytes(b.get(8..12)?.try_into().ok()?)));
    let (mut changed, mut names) = (Vec::new(), BTreeSet::new());
    for (name, bytes) in files() {
        let found = fs::read(dir.join(&name)).ok();
        if found.as_ref() != Some(&bytes) {
            assert!(
                !bless || found.is_none() || version != Some(FORMAT_VERSION),
                "{name} would change within format version {FORMAT_VERSION}: raise it first"
            );
            changed.push(match found {
                Some(_) => format!("{name} has other bytes"),
                None => format!("{name} is not frozen"),
            });
            if bless {
                fs::create_dir_all(&dir).unwrap();
                fs::write(dir.join(&name), bytes).unwrap();
            }
        }
        names.insert(name);
    }
    for entry in fs::read_dir(&dir).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if !names.contains(&name) {
            changed.push(format!("{name} is frozen, and no record has this name"));
        }
    }
    assert!(bless || changed.is_empty(), "{}: {REMEDY}", changed.join("; "));
}

/// A record that is added to the crate is added here.
#[test]
fn every_record_is_frozen() {
    let frozen: BTreeSet<&str> = records().iter().map(|r| r.name).collect();
    for entry in fs::read_dir(root().join("crates/layout/src")).unwrap() {
        let text = fs::read_to_string(entry.unwrap().path()).unwrap();
        for (at, _) in text.match_indices("#[repr(C)]") {
            let rest = &text[at..];
            let name = rest.split("pub struct ").nth(1).and_then(|r| r.split(' ').next()).unwrap();
            assert!(frozen.contains(name), "{name} has no frozen bytes: add it to golden.rs");
        }
    }
}

/// docs/FORMAT.md has a heading with the size of every record, and a table with the offset of every field.
#[test]
fn the_document_says_the_same() {
    let text = fs::read_to_string(root().join("docs/FORMAT.md")).unwrap();
    for record in records() {
        let heading = format!("### `{}`: {} bytes", record.name, record.bytes.len());
        let (_, rest) = text
            .split_once(&format!("{heading}\n"))
            .unwrap_or_else(|| panic!("docs/FORMAT.md has no heading \"{heading}\""));
        let said: Vec<(String, usize)> = rest
            .lines()
            .skip_while(|line| !line.starts_with("| offset | field |"))
            .take_while(|line| line.starts_with('|'))
            .filter_map(|line| {
                let mut cells = line.strip_prefix("| ")?.split(" | ");
                let offset = cells.next()?.parse().ok()?;
                Some((cells.next()?.trim_matches('`').to_string(), offset))
            })
            .collect();
        let is: Vec<(String, usize)> =
            record.fields.iter().map(|&(name, offset)| (name.to_string(), offset)).collect();
        assert_eq!(said, is, "docs/FORMAT.md on {}", record.name);
    }
    for n in 0..=255 {
        if let Some(kind) = ExtentKind::from_u32(n) {
            let row = format!("| {n} | `{kind:?}` |");
            assert!(text.contains(&row), "docs/FORMAT.md has no row \"{row}\"");
        }
    }
    let version = format!("format version **{FORMAT_VERSION}**");
    assert!(text.contains(&version), "docs/FORMAT.md does not describe {version}");
}
