//! dir
#![allow(missing_docs, unused)]
use crate::{Identity, StoreError};
use enf_layout::segment::StageKind;
use std::path::Path;
#[derive(Clone, Debug)]
pub struct StoreDir(());
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IoCounters {
    pub read_bytes: u64,
    pub written_bytes: u64,
    pub inflated_bytes: u64,
}
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageState {
    Absent,
    Unsealed,
    Sealed,
}
impl StoreDir {
    pub fn create(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        unimplemented!()
    }
    pub fn path(&self) -> &Path {
        unimplemented!()
    }
    pub fn io(&self) -> IoCounters {
        unimplemented!()
    }
    pub fn stage_state(&self, stage: StageKind) -> Result<StageState, StoreError> {
        unimplemented!()
    }
    pub fn identity(&self, stage: StageKind) -> Result<Option<Identity>, StoreError> {
        unimplemented!()
    }
    pub fn discard_from(&self, stage: StageKind) -> Result<(), StoreError> {
        unimplemented!()
    }
}
