//! Headers of the files in a store, and the kinds of extents that they hold.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// First eight bytes of every data (segment) file.
pub const SEGMENT_MAGIC: [u8; 8] = *b"ENFSEG\r\n";
/// First eight bytes of every journal file.
pub const JOURNAL_MAGIC: [u8; 8] = *b"ENFJNL\r\n";
/// First eight bytes of every seal file.
pub const SEAL_MAGIC: [u8; 8] = *b"ENFSEAL\n";

/// Every extent begins at a multiple of this many bytes and is padded with zeros to one, so that
/// records can be used in place and no byte of a file is outside a checksum.
pub const EXTENT_ALIGNMENT: u64 = 64;

/// The stages, in pipeline order. The discriminant is what is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum StageKind {
    /// `enf-partition`
    Partition = 1,
    /// `enf-grid`
    Grid = 2,
    /// `enf-trace`
    Trace = 3,
    /// `enf-kdtree`
    Kdtree = 4,
    /// `enf-render`
    Render = 5,
}

impl StageKind {
    /// All stages in pipeline order.
    pub const ALL: [StageKind; 5] =
        [Self::Partition, Self::Grid, Self::Trace, Self::Kdtree, Self::Render];

    /// The stage's name as in file names and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Partition => "partition",
            Self::Grid => "grid",
            Self::Trace => "trace",
            Self::Kdtree => "kdtree",
            Self::Render => "render",
        }
    }

    /// The stage with this stored number.
    pub fn from_u32(value: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&s| s as u32 == value)
    }
}

/// What an extent holds. The discriminant is what is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum ExtentKind {
    /// One [`crate::room::SceneRecord`].
    Scene = 1,
    /// [`crate::material::MaterialRecord`]s; index = material id.
    Materials = 2,
    /// [`crate::light::LightRecord`]s; index = light id.
    Lights = 3,
    /// [`crate::light::EmitterRecord`]s, light by light.
    Emitters = 4,
    /// [`crate::bsp::PlaneRecord`]s.
    Planes = 5,
    /// [`crate::bsp::NodeRecord`]s; node 0 is the root.
    Nodes = 6,
    /// [`crate::bsp::LeafRecord`]s.
    Leaves = 7,
    /// [`crate::bsp::FaceRecord`]s, leaf by leaf.
    Faces = 8,
    /// [`crate::room::RoomRecord`]s; index = room id.
    Rooms = 9,
    /// [`crate::room::PortalRecord`]s.
    Portals = 10,
    /// [`crate::room::PortalPieceRecord`]s, portal by portal.
    PortalPieces = 11,
    /// [`crate::room::TileRecord`]s; index = tile id.
    Tiles = 12,
    /// `u32` light ids, tile by tile ([`crate::room::TileRecord::first_light`]).
    TileLights = 13,
    /// UTF-8 JSON: names of the scene, rooms, materials, lights and views, and the input's units and up axis.
    Names = 14,
    /// [`crate::room::ViewRecord`]s.
    Views = 15,
    /// One tile's mesh, a [`crate::sections`] blob of [`crate::geometry`]; id = tile.
    Geometry = 16,
    /// One tile's uniform grid, a [`crate::sections`] blob; id = tile.
    Grid = 17,
    /// [`crate::photon::PhotonRecord`]s of impacts; id = room.
    Photons = 18,
    /// [`crate::transit::TransitRecord`]s waiting at a tile; id = tile.
    Transit = 19,
    /// One room's photon map, a [`crate::sections`] blob of [`crate::map`]; id = room.
    Map = 20,
    /// [`crate::journal::LightPairRecord`]s of the lights visible from a room, by light; id = room. Written when
    /// the trace ends.
    LightSet = 21,
    /// [`crate::journal::LedgerRecord`]s: what one epoch added.
    Ledger = 22,
    /// Finished pixels of one band of a picture ([`crate::film`]); id = band.
    Film = 23,
    /// Room-to-room passages of photons in one epoch ([`crate::journal::PassageRecord`]).
    Passages = 24,
    /// UTF-8 text, one `key = value` a line: the inputs and flags that a stage's results depend on.
    Identity = 25,
    /// [`crate::journal::LightPairRecord`]s: what one epoch added.
    LightPairs = 26,
    /// One tile's bounding volume hierarchy, a [`crate::sections`] blob of [`crate::bvh`]; id = tile.
    Bvh = 27,
    /// [`crate::profile::ProfileRecord`]s; index = profile id.
    Profiles = 28,
    /// `f32` values of the profiles, one after the other.
    ProfileValues = 29,
    /// One [`crate::sky::SkyRecord`], if the scene has a sky.
    Sky = 32,
    /// [`crate::texture::TextureRecord`]s; index = texture.
    Textures = 34,
    /// Texels of all textures, 3 bytes each.
    Texels = 35,
    /// Texture coordinates of a tile, a [`crate::sections`] blob of [`crate::texture`]; id = tile; absent if none.
    Coordinates = 36,
}

impl ExtentKind {
    /// The kind with this stored number.
    pub fn from_u32(value: u32) -> Option<Self> {
        use ExtentKind::*;
        [
            Scene,
            Materials,
            Lights,
            Emitters,
            Planes,
            Nodes,
            Leaves,
            Faces,
            Rooms,
            Portals,
            PortalPieces,
            Tiles,
            TileLights,
            Names,
            Views,
            Geometry,
            Grid,
            Photons,
            Transit,
            Map,
            LightSet,
            Ledger,
            Film,
            Passages,
            Identity,
            LightPairs,
            Bvh,
            Profiles,
            ProfileValues,
            Sky,
            Textures,
            Texels,
            Coordinates,
        ]
        .into_iter()
        .find(|&k| k as u32 == value)
    }
}

/// How an extent's bytes are stored. The discriminant is what is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Codec {
    /// As they are.
    Raw = 0,
    /// One zstd frame of the bytes.
    Zstd = 1,
    /// One zstd frame of the bytes after [`crate::codec`]'s lossless transform (sections only).
    ZstdPlanes = 2,
}

impl Codec {
    /// The codec with this stored number.
    pub fn from_u32(value: u32) -> Option<Self> {
        [Self::Raw, Self::Zstd, Self::ZstdPlanes].into_iter().find(|&c| c as u32 == value)
    }
}

/// The first 64 bytes of every file in a store.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct FileHeader {
    /// [`SEGMENT_MAGIC`], [`JOURNAL_MAGIC`] or [`SEAL_MAGIC`].
    pub magic: [u8; 8],
    /// [`crate::FORMAT_VERSION`].
    pub version: u32,
    /// [`StageKind`] of the stage that owns the file.
    pub stage: u32,
    /// Number of the process that wrote the file; 0 for a single process.
    pub process: u32,
    /// Number of the file among its kind.
    pub segment: u32,
    /// Size in bytes of one record where the file is a list of them (journal, seal), else 0.
    pub record_size: u32,
    /// Zero.
    pub reserved: u32,
    /// 128-bit hash of what this stage was made from: inputs and flags that affect results.
    pub made_from: [u8; 16],
    /// Zero.
    pub reserved2: [u8; 8],
    /// XXH3-64 of the 56 bytes before it.
    pub checksum: u64,
}
const _: () = assert!(size_of::<FileHeader>() == 64);

/// One file of a finished stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct SealRecord {
    /// The file's name in the store, UTF-8, padded with zeros.
    pub name: [u8; 40],
    /// Its length, bytes.
    pub length: u64,
    /// XXH3-128 of every byte of it.
    pub hash: [u8; 16],
}
const _: () = assert!(size_of::<SealRecord>() == 64);
