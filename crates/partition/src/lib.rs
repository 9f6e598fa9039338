//! `enf-partition`: a building file becomes rooms, portals and tiles in a store.
#![forbid(unsafe_code)]

mod luminaires;
mod tiles;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use enf_geometry::grid_bytes_estimate;
use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_AREA, LightRecord};
use enf_layout::material::{MATERIAL_SEE_THROUGH, MaterialRecord};
use enf_layout::room::SceneRecord;
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_rooms::{Bsp, Hint, RoomCount, TileLimit};
use enf_scene::{Doors, LoadOptions, Scene, Up};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Names;
use enf_stage::{CommonArgs, Failure, IdSink, Result, interrupt, say, warn};
use enf_store::{Array, Identity, MemoryBudget, StageWriter, StoreDir};
use glam::{DVec3, Vec3};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};
use zerocopy::IntoBytes;

pub use luminaires::parse_lux;

/// Resident bytes of a triangle in a mesh and its grid, for planning tiles.
const MESH_BYTES_PER_TRIANGLE: u64 = 27;
/// Bytes that the partitioner needs per triangle beside the triangles themselves.
const WORK_BYTES_PER_TRIANGLE: u64 = 48;

/// More rooms (or random tiles) than this are not made by request.
const MOST_ROOMS: u32 = 65_536;

/// Which axis points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// y, as in most modelling programs.
    Y,
    /// z, as in CAD and BIM.
    Z,
}

/// `--doors`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DoorsArg {
    /// Where the model has them.
    #[default]
    AsModelled,
    /// Objects recognised as doors are left out.
    Open,
}

/// `--hints`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum HintsArg {
    /// Boxes that the scene file calls rooms come first.
    #[default]
    Use,
    /// Rooms come from the walls alone.
    Ignore,
}

/// What decides about rooms, tiles and lights.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Scene options")]
pub struct PartitionArgs {
    /// How many rooms: a number, or auto for as many as the walls make
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = parse_rooms)]
    pub rooms: Rooms,
    /// What becomes of the scene file's room boxes
    #[arg(long, value_enum, default_value_t)]
    pub hints: HintsArg,
    /// What becomes of doors
    #[arg(long, value_enum, default_value_t)]
    pub doors: DoorsArg,
    /// Metres per unit of the model [default: what the scene file says, else 1]
    #[arg(long, value_name = "METRES", value_parser = parse_units)]
    pub units: Option<f64>,
    /// Axis of the model that points up [default: what the scene file says, else z]
    #[arg(long, value_enum)]
    pub up: Option<UpArg>,
    /// Hang a luminaire in every room, sized for this illuminance (for models without lights)
    #[arg(long, value_name = "LUX", value_parser = parse_lux)]
    pub ceiling_lights: Option<f64>,
    /// Cut rooms with more triangles than this into tiles [default: what --memory allows]
    #[arg(long, value_name = "N", value_parser = enf_stage::parse_count)]
    pub tile_triangles: Option<u64>,
    /// Cut the scene into N tiles by random oblique planes through the furniture (for tests: nothing changes)
    #[arg(long, value_name = "N", hide = true,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_ROOMS)))]
    pub random_tiles: Option<u32>,
}

/// `--rooms`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rooms(
    /// How many.
    pub RoomCount,
);

fn parse_units(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(units) if units.is_finite() && units > 0.0 => Ok(units),
        _ => Err("a positive number of metres is wanted".into()),
    }
}

fn parse_rooms(text: &str) -> std::result::Result<Rooms, String> {
    match text {
        "auto" => Ok(Rooms(RoomCount::Auto)),
        _ => match text.parse() {
            Ok(n) if (1..=MOST_ROOMS).contains(&n) => Ok(Rooms(RoomCount::Exactly(n))),
            _ => Err(format!("a number from 1 to {MOST_ROOMS}, or auto")),
        },
    }
}

/// `enf-partition`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(
    name = "enf-partition",
    version,
    about = "Turn a building file into rooms, portals and tiles"
)]
pub struct Cli {
    /// The model: .obj, .obj.zst or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// The store to make
    #[arg(short, long, value_name = "NAME.enf")]
    pub output: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub partition: PartitionArgs,
    /// Discard another run's store
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

/// Lists what a scene is made of, for [`session::begin`].
fn identity(scene: &Scene, args: &PartitionArgs) -> Identity {
    let mut identity = Identity::default();
    for (i, input) in scene.inputs.iter().enumerate() {
        let name = input.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into());
        identity.push(format!("input-{i}"), format!("{name} {:032x}", input.hash));
    }
    let frame = scene.frame();
    identity.push("units", frame.units);
    identity.push("up", if frame.up == Up::Y { "y" } else { "z" });
    identity.push("doors", if args.doors == DoorsArg::Open { "open" } else { "as-modelled" });
    identity.push("hints", if args.hints == HintsArg::Use { "use" } else { "ignore" });
    identity.push(
        "rooms",
        match args.rooms.0 {
            RoomCount::Auto => "auto".to_string(),
            RoomCount::Exactly(n) => n.to_string(),
        },
    );
    identity
        .push("ceiling-lights", args.ceiling_lights.map_or("none".into(), |l| format!("{l} lx")));
    identity
}

/// The scene with everything that rooms add to it, in global triangle order.
pub(crate) struct World {
    corners: Array<[[f32; 3]; 3]>,
    material_of: Array<u32>,
    materials: Vec<MaterialRecord>,
    material_names: Vec<String>,
    lights: Vec<LightRecord>,
    emitters: Vec<EmitterRecord>,
    light_names: Vec<String>,
}

/// Runs the stage.
///
/// # Errors
/// As in the table of exit codes.
pub fn run(cli: &Cli, out: &IdSink) -> Result<serde_json::Value> {
    let (common, args) = (&cli.common, &cli.partition);
    let mut session = Session::open(common)?;
    let options = LoadOptions {
        units: args.units,
        up: args.up.map(|u| if u == UpArg::Y { Up::Y } else { Up::Z }),
        doors: if args.doors == DoorsArg::Open { Doors::Open } else { Doors::AsModelled },
    };
    let lane = session.timeline.lane("partition");
    let scene = {
        let _dense = interrupt::nothing_to_lose()?;
        let _span = lane.span("read scene", 0u32);
        enf_scene::load(&cli.scene, &options).map_err(|e| Failure::input(e.to_string()))?
    };
    let identity = identity(&scene, args);
    let store = create(&cli.output)?;
    let finished =
        match session::begin(&store, StageKind::Partition, common.process, &identity, cli.force)? {
            Begin::Finished => true,
            Begin::Work(writer) => {
                for warning in &scene.warnings {
                    warn(common, warning);
                }
                let writer = if writer.resumed() {
                    // Half a partition is worth nothing: it is made again from the same input.
                    drop(writer);
                    store.discard_from(StageKind::Partition)?;
                    Box::new(StageWriter::open(
                        &store,
                        StageKind::Partition,
                        common.process,
                        &identity,
                    )?)
                } else {
                    writer
                };
                partition(cli, &mut session, &scene, *writer)?;
                false
            }
        };
    drop(scene);
    let tables = enf_stage::tables::Tables::open(&store, &session.budget).map_err(|e| {
        // Its own output is damaged: it can make it again.
        if e.hint.is_none() { e.with_hint(session::MAKE_AGAIN) } else { e }
    })?;
    if finished {
        say(common, "nothing to do, the rooms are there already");
    }
    report(cli, &mut session, &tables);
    let stats = session.finish(common, "partition", &store)?;
    for room in 0..tables.rooms().len() as u32 {
        out.print(room)?;
    }
    Ok(stats)
}

fn create(path: &Path) -> Result<StoreDir> {
    if path.exists() && !path.is_dir() {
        return Err(Failure::usage(format!("{} exists and is no store", path.display()))
            .with_hint("choose another name for -o; a store is a folder NAME.enf"));
    }
    Ok(StoreDir::create(path)?)
}

fn partition(
    cli: &Cli,
    session: &mut Session,
    scene: &Scene,
    mut writer: StageWriter,
) -> Result<()> {
    let (common, args) = (&cli.common, &cli.partition);
    let budget = session.budget.clone();
    let lane = session.timeline.lane("partition");
    let count = scene.triangle_count();
    if count == 0 {
        return Err(Failure::input(format!("{} has no triangles", cli.scene.display())));
    }
    if count > u64::from(NONE - (1 << 20)) {
        return Err(Failure::input(format!(
            "{} has {count} triangles; a store numbers at most 4293918719",
            cli.scene.display()
        )));
    }
    refuse_if_hopeless(cli, &budget, scene, count)?;
    let _scene_bytes = budget.reserve(scene.resident_bytes(), "the scene file's own meshes")?;
    // Ceiling lights add two triangles a room; rooms are few.
    let capacity = count as usize + if args.ceiling_lights.is_some() { 65_536 } else { 0 };
    let mut world = World {
        corners: Array::with_capacity(&budget, capacity, "triangles of the scene")?,
        material_of: Array::with_capacity(&budget, capacity, "materials of the triangles")?,
        materials: scene.materials.iter().map(|m| m.record).collect(),
        material_names: scene.materials.iter().map(|m| m.name.clone()).collect(),
        lights: Vec::new(),
        emitters: Vec::new(),
        light_names: Vec::new(),
    };
    let work =
        budget.reserve(count * WORK_BYTES_PER_TRIANGLE, "walls and lists of the partitioner")?;
    scene.for_each_triangle(|t| {
        let _ = world.corners.push(t.corners);
        let _ = world.material_of.push(t.material);
    });
    let lights = scene.lights();
    world.lights = lights.records;
    world.emitters = lights.emitters;
    world.light_names = lights.names;
    if world.lights.is_empty() && args.ceiling_lights.is_none() {
        return Err(Failure::input(format!("{} has no light", cli.scene.display())).with_hint(
            "--ceiling-lights 500lx hangs one in every room; or give a material Ke, or a scene file a [[light]]",
        ));
    }

    let dense = interrupt::nothing_to_lose()?;
    let options = enf_rooms::Options {
        delta: scene.delta,
        bounds_min: scene.bounds.0,
        bounds_max: scene.bounds.1,
        rooms: args.rooms.0,
        hints: match args.hints {
            HintsArg::Use => scene
                .hints
                .iter()
                .map(|h| Hint { min: h.min, max: h.max, polygon: Vec::new() })
                .collect(),
            HintsArg::Ignore => Vec::new(),
        },
    };
    let mut rooms = {
        let _span = lane.span("find rooms", count);
        let (material_of, materials) = (&world.material_of, &world.materials);
        let opaque =
            |i: usize| materials[material_of[i] as usize].flags & MATERIAL_SEE_THROUGH == 0;
        enf_rooms::partition(&world.corners, &opaque, &options)
            .map_err(|e| Failure::input(format!("{}: {e}", cli.scene.display())))?
    };
    if let Some(lux) = args.ceiling_lights {
        let hung = luminaires::hang(&mut world, rooms.rooms(), lux);
        say(common, format!("hung {hung} ceiling lights for {lux} lx"));
    }
    if world.lights.is_empty() {
        return Err(Failure::input("no room has a ceiling to hang a light from")
            .with_hint("give a material Ke, or a scene file a [[light]]"));
    }

    let per_triangle = MESH_BYTES_PER_TRIANGLE
        + (grid_bytes_estimate(1 << 20) - grid_bytes_estimate(0)) / (1 << 20);
    let limit = match (args.random_tiles, args.tile_triangles) {
        (Some(tiles), _) => TileLimit::Random { tiles, seed: common.seed },
        (None, Some(n)) => TileLimit::Triangles(n.max(1)),
        // A tile, the next one and some cache in what the queues leave.
        (None, None) => TileLimit::Triangles((common.memory / 8 / per_triangle).max(1024)),
    };
    let cut = |e: enf_rooms::RoomsError| match limit {
        TileLimit::Random { .. } => Failure::usage(e.to_string()),
        TileLimit::Triangles(n) => Failure::budget(format!("{e} (a tile may hold {n} triangles)"))
            .with_hint(format!("--memory {}M would do", (common.memory >> 20) * 2)),
    };
    rooms.cut_tiles(&world.corners, limit).map_err(cut)?;
    let mut tables = {
        let _span = lane.span("bin triangles", count);
        rooms.finish(&world.corners)
    };
    drop((work, dense));
    let _lists =
        budget.reserve(4 * tables.tile_triangles.len() as u64, "lists of the tiles' triangles")?;

    // Which lights start in which tile: emitters are in the lists of the tiles that they touch.
    let mut light_of: Vec<(u32, u32)> = Vec::new();
    for (id, light) in world.lights.iter().enumerate() {
        let first = light.first_emitter as usize;
        for emitter in &world.emitters[first..first + light.emitter_count as usize] {
            light_of.push((emitter.triangle, id as u32));
        }
    }
    light_of.sort_unstable();
    let bsp = Bsp::new(
        &tables.planes,
        &tables.nodes,
        &tables.leaves,
        &tables.faces,
        f64::from(scene.delta),
    )
    .map_err(|e| Failure::internal(format!("partition: {e}")))?;
    let mut points: Vec<(u32, u32)> = Vec::new();
    for (id, light) in world.lights.iter().enumerate().filter(|(_, l)| l.kind != LIGHT_AREA) {
        let at = Vec3::from(light.position).as_dvec3();
        // A point in a plane may start photons on either side of it.
        for direction in corners_of_a_cube() {
            let leaf = bsp.locate_towards(at, direction);
            points.push((tables.leaves[leaf as usize].tile, id as u32));
        }
    }
    let mut tile_lights: Vec<u32> = Vec::new();
    for tile in 0..tables.tiles.len() {
        let list = tables.tile_offsets[tile] as usize..tables.tile_offsets[tile + 1] as usize;
        let mut mine: Vec<u32> =
            points.iter().filter(|p| p.0 as usize == tile).map(|p| p.1).collect();
        for &triangle in &tables.tile_triangles[list] {
            let at = light_of.partition_point(|l| l.0 < triangle);
            mine.extend(light_of[at..].iter().take_while(|l| l.0 == triangle).map(|l| l.1));
        }
        mine.sort_unstable();
        mine.dedup();
        tables.tiles[tile].first_light = tile_lights.len() as u32;
        tables.tiles[tile].light_count = mine.len() as u32;
        tile_lights.extend(mine);
    }

    let stored = {
        let _span = lane.span("write tiles", tables.tiles.len() as u64);
        tiles::write(&mut writer, &budget, common, &world, &mut tables)?
    };
    let largest = tables
        .tiles
        .iter()
        .map(|t| t.mesh_bytes + grid_bytes_estimate(t.triangles))
        .max()
        .unwrap_or(0);
    let mut digest = 0u128;
    for (corners, &material) in world.corners.iter().zip(world.material_of.iter()) {
        let mut bytes = [0; 44];
        bytes[..36].copy_from_slice(corners.as_bytes());
        // Materials by what they are, not by their number.
        let hash = xxh3_64(world.materials[material as usize].as_bytes());
        bytes[36..].copy_from_slice(&hash.to_le_bytes());
        digest = digest.wrapping_add(xxh3_128(&bytes));
    }
    let record = SceneRecord {
        origin: scene.origin,
        bounds_min: scene.bounds.0.map(f64::from),
        bounds_max: scene.bounds.1.map(f64::from),
        delta: scene.delta,
        reserved: 0,
        triangles: world.corners.len() as u64,
        stored_triangles: stored,
        geometry_digest: digest.to_le_bytes(),
        rooms: tables.rooms.len() as u32,
        outside: tables.outside.unwrap_or(NONE),
        largest_tile_bytes: largest,
    };
    let names = Names {
        scene: scene.name.clone(),
        rooms: Vec::new(),
        materials: world.material_names,
        lights: world.light_names,
        views: scene.views.iter().map(|v| v.name.clone()).collect(),
        units: scene.frame().units,
        y_up: scene.frame().up == Up::Y,
    };
    let views: Vec<_> = scene.views.iter().map(|v| v.record).collect();
    let names = serde_json::to_vec(&names).map_err(Failure::internal)?;
    let mut put = |kind, count: usize, bytes: &[u8]| {
        writer.append(kind, 0, count as u64, bytes, Codec::Zstd).map(|_| ())
    };
    put(ExtentKind::Scene, 1, record.as_bytes())?;
    put(ExtentKind::Names, 1, &names)?;
    put(ExtentKind::Views, views.len(), views.as_bytes())?;
    put(ExtentKind::Materials, world.materials.len(), world.materials.as_bytes())?;
    put(ExtentKind::Lights, world.lights.len(), world.lights.as_bytes())?;
    put(ExtentKind::Emitters, world.emitters.len(), world.emitters.as_bytes())?;
    put(ExtentKind::Planes, tables.planes.len(), tables.planes.as_bytes())?;
    put(ExtentKind::Nodes, tables.nodes.len(), tables.nodes.as_bytes())?;
    put(ExtentKind::Leaves, tables.leaves.len(), tables.leaves.as_bytes())?;
    put(ExtentKind::Faces, tables.faces.len(), tables.faces.as_bytes())?;
    put(ExtentKind::Rooms, tables.rooms.len(), tables.rooms.as_bytes())?;
    put(ExtentKind::Portals, tables.portals.len(), tables.portals.as_bytes())?;
    put(ExtentKind::PortalPieces, tables.pieces.len(), tables.pieces.as_bytes())?;
    put(ExtentKind::Tiles, tables.tiles.len(), tables.tiles.as_bytes())?;
    put(ExtentKind::TileLights, tile_lights.len(), tile_lights.as_bytes())?;
    writer.seal()?;
    Ok(())
}

/// The partitioner has all triangles in memory at once: said before work begins, with what would do.
fn refuse_if_hopeless(cli: &Cli, budget: &MemoryBudget, scene: &Scene, count: u64) -> Result<()> {
    let (own, meshes) = (budget.reserved(), scene.resident_bytes());
    let (triangles, work) = (count * 40, count * WORK_BYTES_PER_TRIANGLE);
    let needs = own + meshes + triangles + work;
    if needs <= budget.limit() {
        return Ok(());
    }
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    Err(Failure::budget(format!(
        "{}: {count} triangles need {} MiB of {} before there are rooms to name: triangles {}, walls and lists {}, the \
         scene's meshes {}, the program {}",
        cli.scene.display(),
        mib(needs),
        budget.limit() >> 20,
        mib(triangles),
        mib(work),
        mib(meshes),
        mib(own)
    ))
    .with_hint(format!("--memory {}M would do", mib(needs + needs / 8))))
}

fn corners_of_a_cube() -> impl Iterator<Item = DVec3> {
    (0..8).map(|i| {
        let sign = |bit: u32| if i & bit == 0 { 1.0 } else { -1.0 };
        DVec3::new(sign(1), sign(2), sign(4))
    })
}

fn report(cli: &Cli, session: &mut Session, tables: &enf_stage::tables::Tables) {
    let rooms = tables.rooms_without_outside();
    let outside = tables.scene.outside;
    let own = tables.rooms().iter().enumerate().filter(|(i, _)| *i as u32 != outside);
    let triangles: Vec<u64> = own.map(|(_, r)| r.triangles).collect();
    let portals: Vec<_> = tables.portals().iter().filter(|p| p.room < p.other).collect();
    // An empty sum of floats is -0.
    let area = portals.iter().fold(0.0, |sum, p| sum + f64::from(p.area_m2));
    let stats = &mut session.stats;
    stats.set("rooms", rooms);
    stats.set("portals", portals.len());
    stats.set("portal_area_m2", area);
    stats.set("triangles", tables.scene.triangles);
    stats.set("room_triangles_mean", triangles.iter().sum::<u64>() as f64 / rooms.max(1) as f64);
    stats.set("room_triangles_max", triangles.iter().max().copied().unwrap_or(0));
    stats.set("stored_triangles", tables.scene.stored_triangles);
    stats.set("tiles", tables.tiles().len());
    stats.set("leaves", tables.leaves().len());
    stats.set("lights", tables.lights().len());
    say(
        &cli.common,
        format!(
            "{} triangles, {rooms} rooms in {} tiles, {} portals ({area:.1} m2), {} lights",
            tables.scene.triangles,
            tables.tiles().len(),
            portals.len(),
            tables.lights().len()
        ),
    );
}
