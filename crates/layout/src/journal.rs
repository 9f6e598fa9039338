//! The journal: fixed-size records, appended and synced, that make extents visible.
//!
//! A data file's bytes mean nothing until a journal record names them, and a journal record counts
//! only when a [`JournalKind::Commit`] follows it. That is the whole crash protocol.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// What a journal record says. The discriminant is what is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum JournalKind {
    /// An extent was written.
    Extent = 1,
    /// The extent of `process` at (`segment`, `offset`) was consumed and counts no longer.
    Consumed = 2,
    /// `count` is how much of (`extent_kind`, `id`)'s own work is done (emission cursor of a tile).
    Cursor = 3,
    /// Everything before this record is durable.
    Commit = 4,
}

impl JournalKind {
    /// The kind with this stored number.
    pub fn from_u32(value: u32) -> Option<Self> {
        [Self::Extent, Self::Consumed, Self::Cursor, Self::Commit]
            .into_iter()
            .find(|&k| k as u32 == value)
    }
}

/// One journal record, 96 bytes.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct JournalRecord {
    /// Position in the journal, from 0; guards against spliced files.
    pub sequence: u64,
    /// [`JournalKind`].
    pub kind: u32,
    /// [`crate::segment::ExtentKind`].
    pub extent_kind: u32,
    /// Room, tile or band; 0 for tables.
    pub id: u32,
    /// Data file that holds the extent.
    pub segment: u32,
    /// [`crate::segment::Codec`].
    pub codec: u32,
    /// Process whose extent it is: the journal's own, but for what it consumes of others.
    pub process: u32,
    /// First byte of the extent in its data file, a multiple of 64; of a commit, where the data ends.
    pub offset: u64,
    /// Bytes stored, without padding.
    pub stored_bytes: u64,
    /// Bytes after inflating.
    pub raw_bytes: u64,
    /// Records in the extent; a cursor's value; of a commit, the records since the one before.
    pub count: u64,
    /// XXH3-128 of the stored bytes *and their padding*.
    pub data_checksum: [u8; 16],
    /// Zero.
    pub reserved2: u64,
    /// XXH3-64 of the 88 bytes before it.
    pub checksum: u64,
}
const _: () = assert!(size_of::<JournalRecord>() == 96);

/// What one epoch changed in one room: the flux ledger (W, linear Rec.709) and the counts.
///
/// Over all records of a finished trace `emitted = absorbed + escaped`, exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LedgerRecord {
    /// Room.
    pub room: u32,
    /// Zero.
    pub reserved: u32,
    /// Photons whose start lies in this room.
    pub emitted: u64,
    /// Photons whose path ended on a surface of this room.
    pub absorbed: u64,
    /// Photons that left the scene from this room.
    pub escaped: u64,
    /// Impacts stored in this room.
    pub stored: u64,
    /// Flux emitted in this room.
    pub emitted_w: [f64; 3],
    /// Flux absorbed in this room (what survivors were re-weighted by is counted here, so that
    /// the fluxes balance to rounding).
    pub absorbed_w: [f64; 3],
    /// Flux that left the scene from this room.
    pub escaped_w: [f64; 3],
    /// Sum, over photons whose path ended in this room, of their impacts on non-specular surfaces.
    pub reflections_sum: u64,
    /// Smallest such number, `u64::MAX` when none ended.
    pub reflections_min: u64,
    /// Largest such number.
    pub reflections_max: u64,
}
const _: () = assert!(size_of::<LedgerRecord>() == 136);

/// Photons that went from one room to a neighbour in one epoch.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PassageRecord {
    /// Room that was left.
    pub from: u32,
    /// Room that was entered.
    pub to: u32,
    /// Photons.
    pub photons: u64,
    /// Their flux, W, scalar (0.2126 R + 0.7152 G + 0.0722 B).
    pub flux_w: f64,
}
const _: () = assert!(size_of::<PassageRecord>() == 24);

/// A light and a room that see each other: a direct photon of the light landed there, or a probe did.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LightPairRecord {
    /// Room.
    pub room: u32,
    /// Light.
    pub light: u32,
    /// Direct photons of the light that landed in the room.
    pub photons: u64,
    /// Photons that the light emits in the whole trace.
    pub emitted: u64,
}
const _: () = assert!(size_of::<LightPairRecord>() == 24);
