//! Packing bytes for the disk, on whichever thread has time for it.

use std::fmt;

use enf_layout::codec;
use enf_layout::sections::Malformed;
use enf_layout::segment::Codec;
use zstd::bulk::Compressor;
use zstd::zstd_safe::compress_bound;

use crate::{Buffer, MemoryBudget, Reservation, StoreError};

/// zstd's level: inflates at gigabytes per second, and higher ones gain little on byte planes.
const LEVEL: i32 = 3;

/// What a zstd compression context of [`LEVEL`] takes, rounded up.
const COMPRESSOR: u64 = 4 << 20;

/// Scratch up to this size is kept for the next extent.
const KEEP: usize = 4 << 20;

/// An extent's bytes, packed and ready to be appended.
pub struct Encoded {
    pub(crate) codec: Codec,
    pub(crate) raw_bytes: u64,
    pub(crate) stored: Buffer,
}

impl Encoded {
    /// Bytes before packing.
    pub fn raw_bytes(&self) -> u64 {
        self.raw_bytes
    }

    /// Bytes that will be stored, without padding.
    pub fn stored_bytes(&self) -> u64 {
        self.stored.len() as u64
    }
}

impl fmt::Debug for Encoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Encoded({:?}, {} of {} bytes)", self.codec, self.stored.len(), self.raw_bytes)
    }
}

/// Packs bytes outside any budget. Threads that pack much keep an [`Encoder`] each instead.
///
/// # Errors
/// [`StoreError::Malformed`] when `codec` is [`Codec::ZstdPlanes`] and the bytes are no sections blob.
pub fn encode(bytes: &[u8], codec: Codec) -> Result<Encoded, StoreError> {
    Encoder::new(&MemoryBudget::new(u64::MAX)).encode(bytes, codec)
}

/// A compressor with its scratch, reused from extent to extent and counted in a budget.
pub struct Encoder {
    budget: MemoryBudget,
    compressor: Option<(Compressor<'static>, Reservation)>,
    planes: Option<Buffer>,
    packed: Option<Buffer>,
}

impl Encoder {
    /// A new encoder; it reserves memory when it is first used.
    pub fn new(budget: &MemoryBudget) -> Self {
        Self { budget: budget.clone(), compressor: None, planes: None, packed: None }
    }

    /// Packs bytes into a buffer of their own.
    ///
    /// # Errors
    /// [`StoreError::Budget`]; [`StoreError::Malformed`] when `codec` is [`Codec::ZstdPlanes`] and the
    /// bytes are no sections blob.
    pub fn encode(&mut self, bytes: &[u8], codec: Codec) -> Result<Encoded, StoreError> {
        let budget = self.budget.clone();
        let stored = self
            .pack(bytes, codec, |packed| Ok(Buffer::copy_of(&budget, packed, "packed extent")?))?;
        Ok(Encoded { codec, raw_bytes: bytes.len() as u64, stored })
    }

    /// Packs bytes into scratch and hands them to `then`.
    pub(crate) fn pack<R>(
        &mut self,
        bytes: &[u8],
        codec: Codec,
        then: impl FnOnce(&[u8]) -> Result<R, StoreError>,
    ) -> Result<R, StoreError> {
        if codec == Codec::Raw {
            return then(bytes);
        }
        let source = if codec == Codec::ZstdPlanes {
            let planes = scratch(&mut self.planes, &self.budget, bytes.len(), "byte planes")?;
            codec::forward(bytes, planes)?;
            &*planes
        } else {
            bytes
        };
        let failed = |e: std::io::Error| Malformed(format!("zstd cannot compress: {e}"));
        let compressor = match &mut self.compressor {
            Some((compressor, _)) => compressor,
            none => {
                let reservation = self.budget.reserve(COMPRESSOR, "compressor")?;
                &mut none.insert((Compressor::new(LEVEL).map_err(failed)?, reservation)).0
            }
        };
        let most = compress_bound(source.len());
        let packed = scratch(&mut self.packed, &self.budget, most, "compressor output")?;
        let n = compressor.compress_to_buffer(source, packed).map_err(failed)?;
        let result = then(&packed[..n]);
        for spare in [&mut self.planes, &mut self.packed] {
            if spare.as_ref().is_some_and(|b| b.len() > KEEP) {
                *spare = None;
            }
        }
        result
    }
}

impl fmt::Debug for Encoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Encoder({:?})", self.budget)
    }
}

/// `len` bytes of scratch: the old ones if they suffice.
fn scratch<'a>(
    place: &'a mut Option<Buffer>,
    budget: &MemoryBudget,
    len: usize,
    what: &'static str,
) -> Result<&'a mut [u8], StoreError> {
    if place.as_ref().is_none_or(|b| b.len() < len) {
        *place = None;
        *place = Some(Buffer::zeroed(budget, len.max(64 << 10), what)?);
    }
    match place {
        Some(buffer) => Ok(&mut buffer[..len]),
        None => Ok(&mut []),
    }
}
