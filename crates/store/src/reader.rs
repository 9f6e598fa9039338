//! reader
#![allow(missing_docs, unused)]
use crate::{Buffer, Extent, Identity, MemoryBudget, StoreDir, StoreError};
use enf_layout::{
    sections::Malformed,
    segment::{Codec, ExtentKind, StageKind},
};
use zerocopy::{FromBytes, Immutable, KnownLayout};
#[derive(Debug)]
pub struct StageReader(());
#[derive(Debug)]
pub struct Mapped(());
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verified {
    pub files: u64,
    pub bytes: u64,
}
pub fn verify(store: &StoreDir, stage: StageKind) -> Result<Verified, StoreError> {
    unimplemented!()
}
impl std::ops::Deref for Mapped {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        unimplemented!()
    }
}
impl Mapped {
    pub fn as_slice_of<T: FromBytes + Immutable + KnownLayout>(&self) -> Result<&[T], Malformed> {
        unimplemented!()
    }
}
impl StageReader {
    pub fn open(store: &StoreDir, stage: StageKind) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn open_unsealed(store: &StoreDir, stage: StageKind) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn identity(&self) -> &Identity {
        unimplemented!()
    }
    pub fn extents(&self, kind: ExtentKind) -> &[Extent] {
        unimplemented!()
    }
    pub fn find(&self, kind: ExtentKind, id: u32) -> &[Extent] {
        unimplemented!()
    }
    pub fn single(&self, kind: ExtentKind, id: u32) -> Result<&Extent, StoreError> {
        unimplemented!()
    }
    pub fn read(
        &self,
        e: &Extent,
        b: &MemoryBudget,
        what: &'static str,
    ) -> Result<Buffer, StoreError> {
        unimplemented!()
    }
    pub fn map(
        &self,
        e: &Extent,
        b: &MemoryBudget,
        what: &'static str,
    ) -> Result<Mapped, StoreError> {
        unimplemented!()
    }
}
