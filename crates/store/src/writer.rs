//! writer
#![allow(missing_docs, unused)]
use crate::{Buffer, Identity, MemoryBudget, StoreDir, StoreError};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    pub kind: ExtentKind,
    pub id: u32,
    pub stage: StageKind,
    pub process: u32,
    pub segment: u32,
    pub offset: u64,
    pub stored_bytes: u64,
    pub raw_bytes: u64,
    pub count: u64,
    pub codec: Codec,
    pub checksum: [u8; 16],
}
#[derive(Debug)]
pub struct Encoded(());
pub fn encode(bytes: &[u8], codec: Codec) -> Result<Encoded, StoreError> {
    unimplemented!()
}
#[derive(Debug)]
pub struct StageWriter(Vec<Extent>);
impl StageWriter {
    pub fn open(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
        identity: &Identity,
    ) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn with_budget(self, budget: MemoryBudget) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn resumed(&self) -> bool {
        unimplemented!()
    }
    pub fn append(
        &mut self,
        kind: ExtentKind,
        id: u32,
        count: u64,
        bytes: &[u8],
        codec: Codec,
    ) -> Result<Extent, StoreError> {
        unimplemented!()
    }
    pub fn append_encoded(
        &mut self,
        kind: ExtentKind,
        id: u32,
        count: u64,
        encoded: &Encoded,
    ) -> Result<Extent, StoreError> {
        unimplemented!()
    }
    pub fn consume(&mut self, extent: &Extent) {
        unimplemented!()
    }
    pub fn cursor(&mut self, kind: ExtentKind, id: u32, value: u64) {
        unimplemented!()
    }
    pub fn commit(&mut self) -> Result<(), StoreError> {
        unimplemented!()
    }
    pub fn extents(&self) -> impl Iterator<Item = &Extent> {
        self.0.iter()
    }
    pub fn find(&self, kind: ExtentKind, id: u32) -> impl Iterator<Item = &Extent> {
        self.0.iter()
    }
    pub fn cursors(&self) -> impl Iterator<Item = (ExtentKind, u32, u64)> {
        [].into_iter()
    }
    pub fn read(
        &self,
        e: &Extent,
        b: &MemoryBudget,
        what: &'static str,
    ) -> Result<Buffer, StoreError> {
        unimplemented!()
    }
    pub fn release_consumed(&mut self) -> Result<u64, StoreError> {
        unimplemented!()
    }
    pub fn seal(self) -> Result<(), StoreError> {
        unimplemented!()
    }
}
