//! The tables of a partitioned building that every later stage holds for as long as it runs: the BSP, rooms,
//! portals, tiles, materials and lights. They are in the budget, and small beside it.

use enf_layout::bsp::{FaceRecord, LeafRecord, NodeRecord, PlaneRecord};
use enf_layout::light::{EmitterRecord, LIGHT_PROFILE, LightRecord};
use enf_layout::material::MaterialRecord;
use enf_layout::profile::{Profile, ProfileRecord};
use enf_layout::room::{
    PortalPieceRecord, PortalRecord, RoomRecord, SceneRecord, TileRecord, ViewRecord,
};
use enf_layout::segment::{ExtentKind, StageKind};
use enf_layout::sky::SkyRecord;
use enf_layout::texture::TextureRecord;
use enf_rooms::Bsp;
use enf_store::{Buffer, MemoryBudget, StageReader, StoreDir, StoreError};
use zerocopy::{FromBytes, Immutable, KnownLayout};

use crate::failure::{Failure, Result};

/// The tables, and the reader of the partition stage for the tiles' meshes.
pub struct Tables {
    /// Reader of the partition stage.
    pub partition: StageReader,
    /// Facts about the scene.
    pub scene: SceneRecord,
    /// The sky over it, if there is one.
    pub sky: Option<SkyRecord>,
    /// Names of things, and the input's frame.
    pub names: Names,
    materials: Buffer,
    lights: Buffer,
    emitters: Buffer,
    profiles: Buffer,
    profile_values: Buffer,
    planes: Buffer,
    nodes: Buffer,
    leaves: Buffer,
    faces: Buffer,
    rooms: Buffer,
    portals: Buffer,
    pieces: Buffer,
    tiles: Buffer,
    tile_lights: Buffer,
    views: Buffer,
    textures: Buffer,
    texels: Buffer,
}

/// Names that the partition keeps.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Names {
    /// Name of the scene.
    pub scene: String,
    /// By room id; empty when the scene named none.
    pub rooms: Vec<String>,
    /// By material id.
    pub materials: Vec<String>,
    /// By light id.
    pub lights: Vec<String>,
    /// By profile: the files of luminaires.
    #[serde(default)]
    pub profiles: Vec<String>,
    /// By view.
    pub views: Vec<String>,
    /// By view: perspective, panorama or plan; perspective where it is shorter.
    #[serde(default)]
    pub projections: Vec<String>,
    /// Metres per unit of the input.
    pub units: f64,
    /// The input's up axis was y.
    pub y_up: bool,
}

macro_rules! table {
    ($(#[$doc:meta])* $name:ident: $record:ty) => {
        $(#[$doc])*
        pub fn $name(&self) -> &[$record] {
            typed(&self.$name)
        }
    };
}

impl Tables {
    /// Reads the tables of a partitioned store.
    ///
    /// # Errors
    /// Exit 4 when the partition is missing, unfinished or corrupt, exit 3 when the tables do not fit.
    pub fn open(store: &StoreDir, budget: &MemoryBudget) -> Result<Self> {
        let partition = StageReader::open(store, StageKind::Partition)?.with_budget(budget)?;
        let read = |kind| -> Result<Buffer> {
            let extent = partition.single(kind, 0)?;
            Ok(partition.read(extent, budget, "scene tables")?)
        };
        let scene_bytes = read(ExtentKind::Scene)?;
        let scene = SceneRecord::read_from_bytes(&scene_bytes[..])
            .map_err(|_| Failure::input("the store's scene record has a wrong size"))?;
        let sky = match partition.find(ExtentKind::Sky, 0).first() {
            None => None,
            Some(_) => {
                let bytes = read(ExtentKind::Sky)?;
                let sky = SkyRecord::read_from_bytes(&bytes[..]);
                Some(sky.map_err(|_| Failure::input("the store's sky record has a wrong size"))?)
            }
        };
        let names_bytes = read(ExtentKind::Names)?;
        let names = std::str::from_utf8(&names_bytes)
            .ok()
            .and_then(|t| serde_json::from_str(t).ok())
            .ok_or_else(|| Failure::input("the store's table of names is not readable"))?;
        let tables = Self {
            scene,
            sky,
            names,
            materials: checked::<MaterialRecord>(read(ExtentKind::Materials)?)?,
            lights: checked::<LightRecord>(read(ExtentKind::Lights)?)?,
            emitters: checked::<EmitterRecord>(read(ExtentKind::Emitters)?)?,
            profiles: checked::<ProfileRecord>(read(ExtentKind::Profiles)?)?,
            profile_values: checked::<f32>(read(ExtentKind::ProfileValues)?)?,
            planes: checked::<PlaneRecord>(read(ExtentKind::Planes)?)?,
            nodes: checked::<NodeRecord>(read(ExtentKind::Nodes)?)?,
            leaves: checked::<LeafRecord>(read(ExtentKind::Leaves)?)?,
            faces: checked::<FaceRecord>(read(ExtentKind::Faces)?)?,
            rooms: checked::<RoomRecord>(read(ExtentKind::Rooms)?)?,
            portals: checked::<PortalRecord>(read(ExtentKind::Portals)?)?,
            pieces: checked::<PortalPieceRecord>(read(ExtentKind::PortalPieces)?)?,
            tiles: checked::<TileRecord>(read(ExtentKind::Tiles)?)?,
            tile_lights: checked::<u32>(read(ExtentKind::TileLights)?)?,
            views: checked::<ViewRecord>(read(ExtentKind::Views)?)?,
            textures: checked::<TextureRecord>(read(ExtentKind::Textures)?)?,
            texels: checked::<[u8; 3]>(read(ExtentKind::Texels)?)?,
            partition,
        };
        tables.check()?;
        Ok(tables)
    }

    /// Every index that a stage follows is in range, so that a damaged store cannot make one panic.
    fn check(&self) -> Result<()> {
        let bad =
            |what: &str| Err(Failure::input(format!("the store's {what} table is inconsistent")));
        let within = |first: u32, count: u32, len: usize| {
            (u64::from(first) + u64::from(count)) <= len as u64
        };
        let (rooms, tiles) = (self.rooms().len(), self.tiles().len());
        if !self.leaves().iter().all(|l| (l.room as usize) < rooms && (l.tile as usize) < tiles) {
            return bad("leaf");
        }
        if !self.rooms().iter().all(|r| {
            within(r.first_portal, r.portal_count, self.portals().len())
                && within(r.first_tile, r.tile_count, tiles)
        }) {
            return bad("room");
        }
        if !self.portals().iter().all(|p| {
            (p.room as usize) < rooms
                && (p.other as usize) < rooms
                && within(p.first_piece, p.piece_count, self.pieces().len())
        }) {
            return bad("portal");
        }
        if !self.tiles().iter().all(|t| {
            (t.room as usize) < rooms
                && within(t.first_light, t.light_count, self.tile_lights().len())
        }) || !self.tile_lights().iter().all(|&l| (l as usize) < self.lights().len())
        {
            return bad("tile");
        }
        if !self
            .lights()
            .iter()
            .all(|l| within(l.first_emitter, l.emitter_count, self.emitters().len()))
        {
            return bad("light");
        }
        if !self
            .lights()
            .iter()
            .all(|l| l.kind != LIGHT_PROFILE || (l.profile as usize) < self.profiles().len())
            || !self
                .profiles()
                .iter()
                .all(|p| Profile::new(p, self.profile_values()).is_ok_and(|p| p.check().is_ok()))
        {
            return bad("luminaire");
        }
        let (textures, texels) = (self.textures().len(), self.texels().len() as u64);
        if !self.textures().iter().all(|t| {
            let size = u64::from(t.width) * u64::from(t.height);
            size > 0 && u64::from(t.first_texel) + size <= texels
        }) || !self
            .materials()
            .iter()
            .all(|m| m.texture == enf_layout::NONE || (m.texture as usize) < textures)
        {
            return bad("texture");
        }
        Ok(())
    }

    /// The BSP over the tables.
    ///
    /// # Errors
    /// Exit 4 when the tables do not make a tree.
    pub fn bsp(&self) -> Result<Bsp<'_>> {
        Bsp::new(
            self.planes(),
            self.nodes(),
            self.leaves(),
            self.faces(),
            f64::from(self.scene.delta),
        )
        .map_err(|e| Failure::input(format!("the store's BSP is damaged: {e}")))
    }

    table!(/// Materials by id.
        materials: MaterialRecord);
    table!(/// Lights by id.
        lights: LightRecord);
    table!(/// Emitting triangles, light by light.
        emitters: EmitterRecord);
    table!(/// Measured intensities of luminaires, by profile id.
        profiles: ProfileRecord);
    table!(/// Values of the profiles.
        profile_values: f32);
    table!(/// Planes of the BSP.
        planes: PlaneRecord);
    table!(/// Inner nodes of the BSP.
        nodes: NodeRecord);
    table!(/// Leaves of the BSP.
        leaves: LeafRecord);
    table!(/// Faces of the leaves.
        faces: FaceRecord);
    table!(/// Rooms by id.
        rooms: RoomRecord);
    table!(/// Portals by room.
        portals: PortalRecord);
    table!(/// Convex pieces of the portals.
        pieces: PortalPieceRecord);
    table!(/// Tiles by id.
        tiles: TileRecord);
    table!(/// Light ids, tile by tile.
        tile_lights: u32);
    table!(/// The scene's own views.
        views: ViewRecord);

    table!(/// Textures by id.
        textures: TextureRecord);
    table!(/// Texels of all textures, sRGB.
        texels: [u8; 3]);

    /// The emitting triangles of a light.
    pub fn emitters_of(&self, light: &LightRecord) -> &[EmitterRecord] {
        let first = light.first_emitter as usize;
        &self.emitters()[first..first + light.emitter_count as usize]
    }

    /// The intensities of a light that was measured; none for other kinds.
    pub fn profile_of(&self, light: &LightRecord) -> Option<Profile<'_>> {
        if light.kind != LIGHT_PROFILE {
            return None;
        }
        Profile::new(self.profiles().get(light.profile as usize)?, self.profile_values()).ok()
    }

    /// The portals that lead out of a room.
    pub fn portals_of(&self, room: u32) -> &[PortalRecord] {
        let room = &self.rooms()[room as usize];
        &self.portals()
            [room.first_portal as usize..(room.first_portal + room.portal_count) as usize]
    }

    /// The lights that may start in a tile.
    pub fn lights_of(&self, tile: u32) -> &[u32] {
        let tile = &self.tiles()[tile as usize];
        &self.tile_lights()
            [tile.first_light as usize..(tile.first_light + tile.light_count) as usize]
    }

    /// Rooms without the outside, as reports count them.
    pub fn rooms_without_outside(&self) -> usize {
        self.rooms().len() - usize::from(self.scene.outside != enf_layout::NONE)
    }
}

fn checked<T: FromBytes + Immutable + KnownLayout>(buffer: Buffer) -> Result<Buffer> {
    buffer
        .as_slice_of::<T>()
        .map_err(|e| StoreError::from(e).into())
        .map(|_| ())
        .map(|()| buffer)
        .map_err(|e: Failure| e)
}

/// The buffer as records; lengths were checked when the table was read.
fn typed<T: FromBytes + Immutable + KnownLayout>(buffer: &Buffer) -> &[T] {
    buffer.as_slice_of::<T>().unwrap_or(&[])
}
