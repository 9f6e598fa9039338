//! The stage itself: survey, rooms, luminaires, bins, tiles, tables.

use enf_daylight::Grid;
use enf_geometry::structure_bytes_estimate;
use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_AREA, LightRecord};
use enf_layout::material::{MATERIAL_SEE_THROUGH, MaterialRecord};
use enf_layout::room::SceneRecord;
use enf_layout::segment::{Codec, ExtentKind};
use enf_rooms::{Bsp, Hint, Tables};
use enf_scene::{RoomHint, Scene, SceneError, Up};
use enf_stage::session::Session;
use enf_stage::tables::Names;
use enf_stage::{ExitStatus, Failure, Result, interrupt, say, warn};
use enf_store::{MemoryBudget, StageWriter, StoreDir};
use enf_transport::sky::{Daylight, Shell};
use glam::{DVec3, Vec3};
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::IntoBytes;

use crate::args::{Cli, HintsArg};
use crate::bins::{Filling, Record};
use crate::survey::{self, Survey};
use crate::textures::{self, Coordinates};
use crate::tiles::Sorted;
use crate::{luminaires, openings, route};

/// Resident bytes of a triangle in a mesh and its grid, for planning tiles.
const MESH_BYTES_PER_TRIANGLE: u64 = 27;
/// Bytes that finding rooms takes per surveyed triangle, beside the triangle: planes, fragments, lists.
const WORK_BYTES_PER_TRIANGLE: u64 = 48;
/// The cells of the smallest scene, and a tile of it being encoded.
const LEAST_CELLS: u64 = 512 << 10;

/// The scene's materials and lights, with what rooms add to them.
pub(crate) struct World {
    pub(crate) materials: Vec<MaterialRecord>,
    pub(crate) material_names: Vec<String>,
    pub(crate) lights: Vec<LightRecord>,
    pub(crate) emitters: Vec<EmitterRecord>,
    pub(crate) light_names: Vec<String>,
    pub(crate) profiles: enf_scene::Profiles,
    /// Triangles that are not in the scene file, numbered from its last on.
    pub(crate) added: Vec<Record>,
}

impl World {
    /// Notes in each material how large its area lights are on average.
    fn measure_lights(&mut self) {
        let mut sums = vec![(0.0f64, 0u32); self.materials.len()];
        for light in self.lights.iter().filter(|l| l.kind == LIGHT_AREA) {
            if let Some(sum) = sums.get_mut(light.material as usize) {
                *sum = (sum.0 + f64::from(light.area_m2), sum.1 + 1);
            }
        }
        for (material, (area, count)) in self.materials.iter_mut().zip(sums) {
            material.light_area_m2 = (area / f64::from(count.max(1))) as f32;
        }
    }
}

/// Fills an empty store.
///
/// # Errors
/// As in the table of exit codes.
pub(crate) fn build(
    cli: &Cli,
    session: &mut Session,
    scene: &Scene,
    store: &StoreDir,
    mut writer: StageWriter,
) -> Result<()> {
    let (common, args) = (&cli.common, &cli.partition);
    let budget = session.budget.clone();
    let lane = session.timeline.lane("partition");
    let count = scene.triangle_count();
    if count == 0 {
        return Err(Failure::input(format!("{} has no triangles", cli.scene.display())));
    }
    // Ceiling lights come on top.
    if count > u64::from(NONE - (1 << 20)) {
        return Err(Failure::input(format!(
            "{} has {count} triangles; a store numbers at most 4293918719",
            cli.scene.display()
        )));
    }
    refuse_if_hopeless(cli, &budget, scene, count)?;
    let _scene_bytes = budget.reserve(scene.resident_bytes(), "the scene file's own meshes")?;
    let lights = scene.lights().map_err(lost)?;
    let mut world = World {
        materials: scene.materials.iter().map(|m| m.record).collect(),
        material_names: scene.materials.iter().map(|m| m.name.clone()).collect(),
        lights: lights.records,
        emitters: lights.emitters,
        light_names: lights.names,
        profiles: lights.profiles,
        added: Vec::new(),
    };
    if world.lights.is_empty() && args.ceiling_lights.is_none() && scene.sky.is_none() {
        return Err(Failure::input(format!("{} has no light", cli.scene.display())).with_hint(
            "--ceiling-lights 500lx hangs one in every room; or give a material Ke, or a scene file a [[light]] or a \
             [sky]",
        ));
    }

    let dense = interrupt::nothing_to_lose()?;
    let survey = {
        let _span = lane.span("survey", count);
        Survey::take(scene, survey::size(count), common, &budget)?
    };
    let work = budget.reserve(
        survey.corners.len() as u64 * WORK_BYTES_PER_TRIANGLE,
        "walls and lists of the partitioner",
    )?;
    let options = enf_rooms::Options {
        delta: scene.delta,
        bounds_min: scene.bounds.0,
        bounds_max: scene.bounds.1,
        rooms: args.rooms.0,
        hints: match args.hints {
            HintsArg::Use => scene.hints.iter().map(hint).collect(),
            HintsArg::Ignore => Vec::new(),
        },
    };
    let mut rooms = {
        let _span = lane.span("find rooms", survey.corners.len() as u64);
        let (material_of, materials) = (&survey.material_of, &world.materials);
        let opaque =
            |i: usize| materials[material_of[i] as usize].flags & MATERIAL_SEE_THROUGH == 0;
        enf_rooms::partition(&survey.corners, &opaque, &options)
            .map_err(|e| Failure::input(format!("{}: {e}", cli.scene.display())))?
    };
    if let Some(lux) = args.ceiling_lights {
        // Which room each large triangle is seen from: few are seen from two.
        let _near = budget.reserve(survey.corners.len() as u64 * 32, "ceilings of the rooms")?;
        let hung = luminaires::hang(&mut world, &rooms, &survey.corners, count as u32, lux);
        say(common, format!("hung {hung} ceiling lights for {lux} lx"));
    }
    if world.lights.is_empty() && scene.sky.is_none() {
        return Err(Failure::input("no room has a ceiling to hang a light from")
            .with_hint("give a material Ke, or a scene file a [[light]]"));
    }
    world.measure_lights();
    if let Some(tiles) = args.random_tiles {
        rooms
            .cut_at_random(&survey.corners, tiles, common.seed)
            .map_err(|e| Failure::usage(e.to_string()))?;
    }
    drop((survey, work));
    enf_store::give_back_free_memory();
    let tree = budget.reserve(rooms.resident_bytes(), "cells of the partitioner")?;

    let per_triangle = MESH_BYTES_PER_TRIANGLE
        + (structure_bytes_estimate(1 << 20) - structure_bytes_estimate(0)) / (1 << 20);
    let limit = match (args.random_tiles, args.tile_triangles) {
        (Some(_), _) => u64::MAX,
        (None, Some(n)) => n.max(1),
        // A tile, the next one and some cache in what the queues leave.
        (None, None) => (common.memory / 8 / per_triangle).max(1024),
    };
    // Materials by what they are, not by their number.
    let material_hash: Vec<u64> = world.materials.iter().map(|m| xxh3_64(m.as_bytes())).collect();
    let (passed, bins) = {
        let _span = lane.span("sort triangles", count);
        let _batches =
            budget.reserve(route::memory_bytes(common.threads), "batches of triangles")?;
        let mut filling = Filling::new(store, &budget, rooms.pieces().len())?;
        let extra = &world.added;
        let passed = route::route(scene, extra, &rooms, &material_hash, common, &mut filling)?;
        (passed, filling.full()?)
    };
    let coordinates = {
        let _span = lane.span("sort texture coordinates", scene.textures.len() as u64);
        Coordinates::collect(scene, store, &budget)?
    };
    let mut sorted = Sorted::new(&rooms, bins);
    {
        let _span = lane.span("cut tiles", 0u32);
        sorted.cut(&mut rooms, store, &budget, limit)?;
    }
    for &room in rooms.oversized() {
        warn(common, format!("room {room} cannot be cut into tiles of {limit} triangles"));
    }
    let mut tables = rooms.tables(&sorted.order());
    drop((tree, dense));
    for (room, triangles) in tables.rooms.iter_mut().zip(&passed.owned) {
        room.triangles = *triangles;
    }

    if let Some(sky) = &scene.sky {
        let _sky = budget.reserve(Grid::BYTES, "the sky")?;
        let shell = Shell::new(scene.bounds.0.map(f64::from), scene.bounds.1.map(f64::from));
        let found = openings::let_in(&mut world, &tables, sky, &shell);
        if found.openings == 0 {
            let why = match tables.outside {
                Some(_) => "no room has an opening to the outside",
                None => "everything is one room",
            };
            warn(
                common,
                format!("{why}: the [sky] is not aimed at windows, and its light will be coarse"),
            );
        } else {
            say(
                common,
                format!(
                    "daylight comes in through {} openings, {:.1} m2",
                    found.openings, found.area
                ),
            );
        }
    }
    let starts = Starts::new(&world, &tables, scene)?;
    let mut tile_lights: Vec<u32> = Vec::new();
    let mut written: Vec<(u64, u64, u32)> = Vec::with_capacity(tables.tiles.len());
    let mut coordinate_bytes: Vec<u64> = Vec::with_capacity(tables.tiles.len());
    {
        let _span = lane.span("write tiles", tables.tiles.len() as u64);
        let lights_of = |record: &Record, lights: &mut Vec<u32>| starts.of_triangle(record, lights);
        sorted.write(
            &mut writer,
            &budget,
            common,
            &lights_of,
            coordinates.as_ref(),
            |triangles, bytes, textured, mut lights| {
                coordinate_bytes.push(textured);
                starts.of_points(written.len() as u32, &mut lights);
                lights.sort_unstable();
                lights.dedup();
                written.push((triangles, bytes, lights.len() as u32));
                tile_lights.extend(lights);
            },
        )?;
    }
    drop((sorted, coordinates));
    textures::write(scene, args.texture_memory, common, &budget, &mut writer)?;
    let mut stored = 0;
    let mut largest = 0;
    let mut first_light = 0;
    let written = written.into_iter().zip(coordinate_bytes);
    for (tile, ((triangles, bytes, lights), textured)) in tables.tiles.iter_mut().zip(written) {
        tile.triangles = triangles;
        tile.mesh_bytes = bytes;
        tile.first_light = first_light;
        tile.light_count = lights;
        first_light += lights;
        stored += triangles;
        largest = largest.max(bytes + textured + structure_bytes_estimate(triangles));
    }
    let record = SceneRecord {
        origin: scene.origin,
        bounds_min: scene.bounds.0.map(f64::from),
        bounds_max: scene.bounds.1.map(f64::from),
        delta: scene.delta,
        reserved: 0,
        triangles: count + world.added.len() as u64,
        stored_triangles: stored,
        geometry_digest: passed.digest.to_le_bytes(),
        rooms: tables.rooms.len() as u32,
        outside: tables.outside.unwrap_or(NONE),
        largest_tile_bytes: largest,
    };
    // A room is called as the hint that holds its point of view.
    let called = |room: &enf_layout::room::RoomRecord| {
        let found = options.hints.iter().position(|h| h.contains(room.inside));
        found.map_or_else(String::new, |i| scene.hints[i].name.clone())
    };
    let names = tables.rooms.iter().map(called).collect();
    write_tables(scene, &world, &tables, names, &record, &tile_lights, &mut writer)?;
    writer.seal()?;
    Ok(())
}

/// What is wrong with a scene, or with the place where its large meshes are kept meanwhile.
pub(crate) fn lost(error: SceneError) -> Failure {
    Failure::new(ExitStatus::from_code(error.exit_code()), error.to_string())
}

fn hint(hint: &RoomHint) -> Hint {
    Hint { min: hint.min, max: hint.max, polygon: hint.polygon.clone() }
}

fn write_tables(
    scene: &Scene,
    world: &World,
    tables: &Tables,
    rooms: Vec<String>,
    record: &SceneRecord,
    tile_lights: &[u32],
    writer: &mut StageWriter,
) -> Result<()> {
    let names = Names {
        scene: scene.name.clone(),
        rooms,
        materials: world.material_names.clone(),
        lights: world.light_names.clone(),
        profiles: world.profiles.names.clone(),
        views: scene.views.iter().map(|v| v.name.clone()).collect(),
        projections: scene.views.iter().map(|v| v.projection.name().to_string()).collect(),
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
    if let Some(sky) = &scene.sky {
        put(ExtentKind::Sky, 1, sky.as_bytes())?;
    }
    put(ExtentKind::Materials, world.materials.len(), world.materials.as_bytes())?;
    put(ExtentKind::Lights, world.lights.len(), world.lights.as_bytes())?;
    put(ExtentKind::Emitters, world.emitters.len(), world.emitters.as_bytes())?;
    let profiles = &world.profiles;
    put(ExtentKind::Profiles, profiles.records.len(), profiles.records.as_bytes())?;
    put(ExtentKind::ProfileValues, profiles.values.len(), profiles.values.as_bytes())?;
    put(ExtentKind::Planes, tables.planes.len(), tables.planes.as_bytes())?;
    put(ExtentKind::Nodes, tables.nodes.len(), tables.nodes.as_bytes())?;
    put(ExtentKind::Leaves, tables.leaves.len(), tables.leaves.as_bytes())?;
    put(ExtentKind::Faces, tables.faces.len(), tables.faces.as_bytes())?;
    put(ExtentKind::Rooms, tables.rooms.len(), tables.rooms.as_bytes())?;
    put(ExtentKind::Portals, tables.portals.len(), tables.portals.as_bytes())?;
    put(ExtentKind::PortalPieces, tables.pieces.len(), tables.pieces.as_bytes())?;
    put(ExtentKind::Tiles, tables.tiles.len(), tables.tiles.as_bytes())?;
    put(ExtentKind::TileLights, tile_lights.len(), tile_lights.as_bytes())?;
    Ok(())
}

/// Which lights start in which tile: area lights in every tile that lists one of their triangles.
struct Starts {
    /// (triangle, light), ascending.
    triangles: Vec<(u32, u32)>,
    /// (tile, light), ascending.
    points: Vec<(u32, u32)>,
}

impl Starts {
    fn new(world: &World, tables: &Tables, scene: &Scene) -> Result<Self> {
        let mut triangles: Vec<(u32, u32)> = Vec::with_capacity(world.emitters.len());
        for (id, light) in world.lights.iter().enumerate().filter(|(_, l)| l.kind == LIGHT_AREA) {
            let first = light.first_emitter as usize;
            for emitter in &world.emitters[first..first + light.emitter_count as usize] {
                triangles.push((emitter.triangle, id as u32));
            }
        }
        triangles.sort_unstable();
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
            if Daylight::is_daylight(light) {
                let id = id as u32;
                let first = light.first_emitter as usize;
                let own = &world.emitters[first..first + light.emitter_count as usize];
                openings::tiles(own, &tables.tiles, scene.bounds, |tile| points.push((tile, id)));
                continue;
            }
            let at = Vec3::from(light.position).as_dvec3();
            // A point in a plane may start photons on either side of it.
            for direction in corners_of_a_cube() {
                let leaf = bsp.locate_towards(at, direction);
                points.push((tables.leaves[leaf as usize].tile, id as u32));
            }
        }
        points.sort_unstable();
        Ok(Self { triangles, points })
    }

    fn of_triangle(&self, record: &Record, lights: &mut Vec<u32>) {
        let at = self.triangles.partition_point(|l| l.0 < record.index);
        let own = self.triangles[at..].iter().take_while(|l| l.0 == record.index);
        for &(_, light) in own {
            if lights.last() != Some(&light) {
                lights.push(light);
            }
        }
    }

    fn of_points(&self, tile: u32, lights: &mut Vec<u32>) {
        let at = self.points.partition_point(|l| l.0 < tile);
        lights.extend(self.points[at..].iter().take_while(|l| l.0 == tile).map(|l| l.1));
    }
}

fn corners_of_a_cube() -> impl Iterator<Item = DVec3> {
    (0..8).map(|i| {
        let sign = |bit: u32| if i & bit == 0 { 1.0 } else { -1.0 };
        DVec3::new(sign(1), sign(2), sign(4))
    })
}

/// Walls are found in memory: whether there is place for that is said before work begins, with what would do.
fn refuse_if_hopeless(cli: &Cli, budget: &MemoryBudget, scene: &Scene, count: u64) -> Result<()> {
    let (own, meshes) = (budget.reserved(), scene.resident_bytes());
    let size = survey::size(count);
    let (triangles, work) = (survey::bytes(count), size * WORK_BYTES_PER_TRIANGLE);
    // First the survey, then, when it is gone, the bins.
    let sorting = route::memory_bytes(cli.common.threads) + Filling::LEAST_BYTES + LEAST_CELLS;
    let needs = own + meshes + (triangles + work).max(sorting);
    if needs <= budget.limit() {
        return Ok(());
    }
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    Err(Failure::budget(format!(
        "{}: to find rooms in the {size} largest of {count} triangles needs {} MiB of {}: triangles {}, walls \
         and lists {}, then sorting {}, the scene's meshes {}, the program {}",
        cli.scene.display(),
        mib(needs),
        budget.limit() >> 20,
        mib(triangles),
        mib(work),
        mib(sorting),
        mib(meshes),
        mib(own)
    ))
    .with_hint(format!("--memory {}M would do", mib(needs + needs / 8))))
}
