//! Walls from OBJ and PLY files, and a way through them.
//!
//! A mesh knows nothing of its lumen. The middle is found by walking from the widest place inside to both sides: each
//! step goes where the view is longest and is then brought back to the middle of what is seen around it.

use super::Axis;
use crate::SimError;
use crate::random::Key;
use crate::surface::{Posed, Topology, Vertex, Wall};
use endoscape_core::Image;
use endoscape_frames::picture;
use nalgebra::{UnitQuaternion, Vector3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{PropertyAccess, PropertyAccessResult};
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::path::Path;

/// Largest extent that is an organ in metres; beyond, the unit is wrong.
const LARGEST_M: f64 = 3.0;
/// Smallest extent in which a camera finds room.
const SMALLEST_M: f64 = 0.01;

pub(super) struct Imported {
    pub wall: Wall,
    pub axis: Axis,
    pub texture: Option<Image>,
}

/// Corners of triangles with their texture coordinates.
#[derive(Default)]
struct Soup {
    points: Vec<Vector3<f64>>,
    faces: Vec<[u32; 3]>,
    texture_coordinates: Vec<[[f32; 2]; 3]>,
    texture: Option<Image>,
}

pub(super) fn load(path: &Path, metres_per_unit: f64) -> Result<Imported, SimError> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let soup = match extension.as_deref() {
        Some("obj") => read_obj(path)?,
        Some("ply") => read_ply(path)?,
        _ => {
            return Err(SimError::mesh(
                path,
                "is neither an OBJ nor a PLY file by its name",
                "give a .obj or .ply file",
            ));
        }
    };
    let textured = soup.texture_coordinates.len() == soup.faces.len() && soup.texture.is_some();
    let mut wall = bare_wall(path, &soup, metres_per_unit)?;
    let axis = middle(path, &wall)?;
    attach(&mut wall, &axis);
    if let (Topology::Triangles { texture_coordinates, .. }, true) = (&mut wall.topology, textured) {
        *texture_coordinates = Some(soup.texture_coordinates);
    }
    Ok(Imported { wall, axis, texture: soup.texture.filter(|_| textured) })
}

fn read_obj(path: &Path) -> Result<Soup, SimError> {
    let damaged = |reason: String| SimError::mesh(path, reason, "export the mesh again");
    let options =
        tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    std::fs::metadata(path).map_err(|error| endoscape_frames::FramesError::io(path, "read", error))?;
    let (models, materials) = tobj::load_obj(path, &options)
        .map_err(|error| damaged(format!("is no readable OBJ file ({})", one_line(&error))))?;
    let mut soup = Soup::default();
    for tobj::Model { mesh, .. } in models {
        let first = soup.points.len() as u32;
        soup.points.extend(mesh.positions.as_chunks::<3>().0.iter().map(|p| Vector3::from(p.map(f64::from))));
        soup.faces.extend(mesh.indices.as_chunks::<3>().0.iter().map(|face| face.map(|index| first + index)));
        let coordinate = |index: u32| {
            let at = 2 * index as usize;
            [mesh.texcoords.get(at).copied().unwrap_or(0.0), mesh.texcoords.get(at + 1).copied().unwrap_or(0.0)]
        };
        soup.texture_coordinates
            .extend(mesh.texcoord_indices.as_chunks::<3>().0.iter().map(|face| face.map(coordinate)));
    }
    // A missing material file is common and no reason to refuse the shape.
    let file = materials.ok().and_then(|all| all.into_iter().find_map(|material| material.diffuse_texture));
    if let Some(file) = file.map(|file| path.with_file_name(file)).filter(|file| file.is_file()) {
        soup.texture = Some(picture::read(&file)?);
    }
    Ok(soup)
}

/// What a parser says, without the lines it shows below that.
fn one_line(error: &dyn std::fmt::Display) -> String {
    error.to_string().lines().next().unwrap_or_default().trim_end_matches(['.', ':']).to_string()
}

/// A vertex as PLY files have it.
#[derive(Debug, Default)]
struct PlyVertex([f64; 3]);

impl PlyVertex {
    fn set(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match ["x", "y", "z"].iter().position(|known| *known == name) {
            Some(at) => {
                self.0[at] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }
}

impl PropertyAccess for PlyVertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, f64::from(value))
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set(name, value)
    }
}

/// A face as PLY files have it.
#[derive(Debug, Default)]
struct PlyFace(Vec<u32>);

impl PlyFace {
    fn set(&mut self, name: &str, corners: Vec<u32>) -> PropertyAccessResult {
        if !matches!(name, "vertex_indices" | "vertex_index") {
            return PropertyAccessResult::Ignored;
        }
        self.0 = corners;
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for PlyFace {
    fn new() -> Self {
        Self::default()
    }

    fn set_list_int(&mut self, name: &str, corners: Vec<i32>) -> PropertyAccessResult {
        self.set(name, corners.into_iter().map(|index| u32::try_from(index).unwrap_or(u32::MAX)).collect())
    }

    fn set_list_uint(&mut self, name: &str, corners: Vec<u32>) -> PropertyAccessResult {
        self.set(name, corners)
    }
}

fn read_ply(path: &Path) -> Result<Soup, SimError> {
    let damaged = |reason: String| SimError::mesh(path, reason, "export the mesh again");
    let unreadable = |error: &dyn std::fmt::Display| damaged(format!("is no readable PLY file ({})", one_line(error)));
    let file = std::fs::File::open(path).map_err(|error| endoscape_frames::FramesError::io(path, "read", error))?;
    let mut reader = Reader::new(std::io::BufReader::new(file));
    let (vertices, faces) = (Parser::<PlyVertex>::new(), Parser::<PlyFace>::new());
    let header = vertices.read_header(&mut reader).map_err(|error| unreadable(&error))?;
    let mut soup = Soup::default();
    for (name, element) in &header.elements {
        if name == "face" {
            let read = faces.read_payload_for_element(&mut reader, element, &header);
            for PlyFace(corners) in read.map_err(|error| unreadable(&error))? {
                // A polygon is a fan of triangles around its first corner.
                soup.faces.extend(corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]));
            }
        } else {
            let read = vertices.read_payload_for_element(&mut reader, element, &header);
            let read = read.map_err(|error| unreadable(&error))?;
            if name == "vertex" {
                soup.points = read.into_iter().map(|vertex| Vector3::from(vertex.0)).collect();
            }
        }
    }
    Ok(soup)
}

/// The wall without its relation to the lumen, centred on the origin, in metres.
fn bare_wall(path: &Path, soup: &Soup, metres_per_unit: f64) -> Result<Wall, SimError> {
    let refuse = |reason: String, remedy| Err(SimError::mesh(path, reason, remedy));
    if soup.faces.is_empty() {
        return refuse("has no faces".into(), "export a surface, not points or lines");
    }
    if let Some(at) = soup.points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
        return refuse(format!("vertex {} is not a number", at + 1), "export the mesh again");
    }
    if let Some(index) = soup.faces.iter().flatten().find(|index| **index as usize >= soup.points.len()) {
        let count = soup.points.len();
        return refuse(format!("a face names vertex {index} (from 0) but there are {count}"), "export the mesh again");
    }
    let used = || soup.faces.iter().flatten().map(|index| soup.points[*index as usize]);
    let low = used().fold(Vector3::repeat(f64::INFINITY), |low, point| low.inf(&point));
    let high = used().fold(Vector3::repeat(f64::NEG_INFINITY), |high, point| high.sup(&point));
    let extent_m = (high - low).norm() * metres_per_unit;
    if !(SMALLEST_M..=LARGEST_M).contains(&extent_m) {
        let reason = format!("is {extent_m:.4} m across at {metres_per_unit} m per unit, no size of an organ");
        return refuse(reason, "give the length of its unit with --mesh-unit");
    }
    let middle = (low + high) * 0.5;
    let vertex = |point: &Vector3<f64>| {
        let rest = (point - middle) * metres_per_unit;
        Vertex { rest, inward: Vector3::zeros(), along_m: 0.0, around_rad: 0.0, fold: 0.0 }
    };
    let vertices = soup.points.iter().map(vertex).collect();
    Ok(Wall { vertices, topology: Topology::Triangles { faces: soup.faces.clone(), texture_coordinates: None } })
}

/// Tells every vertex where the middle of the lumen is from it.
fn attach(wall: &mut Wall, axis: &Axis) {
    let count = (axis.length_m() / 0.001).ceil() as usize;
    let places: Vec<(f64, Vector3<f64>)> = (0..=count)
        .map(|i| axis.length_m() * i as f64 / count as f64)
        .map(|along_m| (along_m, axis.point(along_m)))
        .collect();
    wall.vertices.par_iter_mut().for_each(|vertex| {
        let distance = |place: &&(f64, Vector3<f64>)| (place.1 - vertex.rest).norm_squared();
        if let Some((along_m, point)) = places.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) {
            (vertex.along_m, vertex.inward) = (*along_m, point - vertex.rest);
            let across = axis.frame(*along_m).inverse() * -vertex.inward;
            vertex.around_rad = across.y.atan2(across.x);
        }
    });
}

/// The curve through the middle of the lumen.
fn middle(path: &Path, wall: &Wall) -> Result<Axis, SimError> {
    let posed = Posed::new(wall);
    let no_room = || {
        SimError::mesh(
            path,
            "has no inside wide enough for a camera",
            "give a closed surface in its true size with --mesh-unit",
        )
    };
    let (start, _) = widest_place(wall, &posed).ok_or_else(no_room)?;
    let heading = longest_view(&posed, &start);
    let mut knots = walk(&posed, start, -heading);
    knots.reverse();
    knots.extend(walk(&posed, start, heading).into_iter().skip(1));
    if knots.len() < 4 { Err(no_room()) } else { Ok(Axis::through(&knots)) }
}

/// Directions spread evenly over the sphere (a Fibonacci lattice).
fn all_around(count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let golden = TAU * (1.0 - 0.5 * (5.0_f64.sqrt() - 1.0));
    (0..count).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let radius = (1.0 - z * z).sqrt();
        Vector3::new(radius * (golden * i as f64).cos(), radius * (golden * i as f64).sin(), z)
    })
}

/// Least distance to the wall over directions all around; `None` if a view leaves the mesh, so outside it.
fn clearance_m(posed: &Posed<'_>, place: &Vector3<f64>) -> Option<f64> {
    let distances = all_around(40).map(|direction| posed.cast(place, &direction, LARGEST_M).map(|hit| hit.distance_m));
    let seen: Vec<f64> = distances.flatten().collect();
    // A few rays may find a hole of an unfinished mesh.
    (seen.len() >= 36).then(|| seen.into_iter().fold(f64::INFINITY, f64::min))
}

fn widest_place(wall: &Wall, posed: &Posed<'_>) -> Option<(Vector3<f64>, f64)> {
    const CANDIDATES: u64 = 1500;
    let key = Key::new(0).of("inside");
    // Half-way between two points of the wall: inside more often than not.
    let candidate = |i: u64| {
        let mut series = key.at(i).series();
        let mut any = || wall.vertices[series.index(0, wall.vertices.len())].rest;
        (any() + any()) * 0.5
    };
    let found: Vec<(Vector3<f64>, f64)> = (0..CANDIDATES)
        .into_par_iter()
        .filter_map(|i| Some((candidate(i), clearance_m(posed, &candidate(i))?)))
        .collect();
    found.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, clearance_m)| *clearance_m > 0.003)
}

fn longest_view(posed: &Posed<'_>, place: &Vector3<f64>) -> Vector3<f64> {
    let reach = |direction: &Vector3<f64>| posed.cast(place, direction, LARGEST_M).map_or(0.0, |hit| hit.distance_m);
    all_around(200).max_by(|a, b| reach(a).total_cmp(&reach(b))).unwrap_or_else(Vector3::z)
}

/// Steps along the lumen until it narrows or ends.
fn walk(posed: &Posed<'_>, start: Vector3<f64>, heading: Vector3<f64>) -> Vec<Vector3<f64>> {
    const MOST_STEPS: usize = 1200;
    let (mut places, mut heading) = (vec![start], heading);
    while let (Some(place), true) = (places.last().copied(), places.len() < MOST_STEPS) {
        let Some(room_m) = clearance_m(posed, &place) else { break };
        let step_m = (0.35 * room_m).clamp(0.001, 0.006);
        let (mut sum, mut ahead_m) = (Vector3::zeros(), 0.0_f64);
        for direction in all_around(160).filter(|direction| direction.dot(&heading) > 0.5) {
            let distance_m = posed.cast(&place, &direction, LARGEST_M).map_or(0.0, |hit| hit.distance_m);
            sum += direction * distance_m * distance_m;
            ahead_m = ahead_m.max(distance_m);
        }
        if room_m < 0.0025 || ahead_m < 1.6 * room_m.max(0.004) {
            break;
        }
        heading = (heading + sum.try_normalize(0.0).unwrap_or(heading)).normalize();
        let next = centred(posed, place + heading * step_m, &heading);
        let visited = places.iter().rev().skip(12).any(|before| (before - next).norm() < 0.5 * step_m);
        if visited || (next - place).norm() < 0.2 * step_m {
            break;
        }
        places.push(next);
    }
    places
}

/// A place moved half-way to the middle of the wall seen square to the heading.
fn centred(posed: &Posed<'_>, place: Vector3<f64>, heading: &Vector3<f64>) -> Vector3<f64> {
    const SPOKES: usize = 24;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), heading).unwrap_or_else(UnitQuaternion::identity);
    let spoke = |i: usize| {
        let angle = TAU * i as f64 / SPOKES as f64;
        let direction = turn * Vector3::new(angle.cos(), angle.sin(), 0.0);
        direction * posed.cast(&place, &direction, LARGEST_M).map_or(0.0, |hit| hit.distance_m)
    };
    place + (0..SPOKES).map(spoke).sum::<Vector3<f64>>() / SPOKES as f64 * 0.5
}
