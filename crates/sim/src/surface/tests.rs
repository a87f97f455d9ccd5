use super::*;
use crate::random::Key;
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

fn vertex(rest: Vector3<f64>) -> Vertex {
    Vertex { rest, inward: -rest, along_m: 0.0, around_rad: 0.0, fold: 0.0 }
}

fn sphere(radius_m: f64, rows: usize, columns: usize) -> Wall {
    Wall::net(rows, columns, true, |row, column| {
        let (polar, around) = (PI * row as f64 / (rows - 1) as f64, TAU * column as f64 / columns as f64);
        vertex(Vector3::new(polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()) * radius_m)
    })
}

fn direction(i: u64) -> Vector3<f64> {
    let mut series = Key::new(5).at(i).series();
    let mut part = || series.range(-1.0, 1.0);
    Vector3::new(part(), part(), part()).normalize()
}

/// Largest error of the distance over many rays from inside; every ray must hit.
fn worst(wall: &Wall, exact: impl Fn(&Vector3<f64>, &Vector3<f64>) -> f64) -> f64 {
    let posed = Posed::new(wall);
    let errors = (0..4000).map(|i| {
        let (origin, direction) = (direction(i + 10_000) * 0.004, direction(i));
        let hit = posed.cast(&origin, &direction, 1.0).unwrap();
        (hit.distance_m - exact(&origin, &direction)).abs()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_sphere_is_met_where_it_is() {
    let exact = |o: &Vector3<f64>, d: &Vector3<f64>| {
        let b = o.dot(d);
        -b + (b * b - o.norm_squared() + 0.02 * 0.02).sqrt()
    };
    assert!(worst(&sphere(0.02, 120, 240), exact) < 1e-7);
}

#[test]
fn a_cylinder_and_its_ends_are_met_where_they_are() {
    let (radius, half) = (0.015, 0.2);
    let wall = Wall::net(160, 200, true, |row, column| {
        let around = TAU * column as f64 / 200.0;
        let z = half * (2.0 * row as f64 / 159.0 - 1.0);
        vertex(Vector3::new(radius * around.cos(), radius * around.sin(), z))
    });
    let posed = Posed::new(&wall);
    for i in 0..4000 {
        let (o, d) = (direction(i + 10_000) * 0.004, direction(i));
        let (a, b, c) = (d.xy().norm_squared(), o.xy().dot(&d.xy()), o.xy().norm_squared() - radius * radius);
        let exact = (-b + (b * b - a * c).sqrt()) / a;
        match posed.cast(&o, &d, 10.0) {
            Some(hit) => assert!((hit.distance_m - exact).abs() < 1e-7, "{} {exact}", hit.distance_m),
            None => assert!((o + d * exact).z.abs() > half - 1e-6, "a hole in the wall"),
        }
    }
}

#[test]
fn a_plane_is_met_where_it_is() {
    let wall = Wall::net(20, 30, false, |row, column| {
        vertex(Vector3::new(column as f64 * 0.002 - 0.03, row as f64 * 0.003 - 0.03, 0.02))
    });
    let posed = Posed::new(&wall);
    let mut hits = 0;
    for i in 0..2000 {
        let d = direction(i);
        let Some(hit) = posed.cast(&Vector3::zeros(), &d, 1.0) else { continue };
        hits += 1;
        assert!((hit.distance_m * d.z - 0.02).abs() < 1e-12);
        assert!((hit.normal + Vector3::z()).norm() < 1e-9);
    }
    assert!(hits > 300);
}

#[test]
fn sites_and_hits_are_the_same_points() {
    let wall = sphere(0.02, 60, 120);
    let mut posed = Posed::new(&wall);
    for squeeze in [1.0, 0.6] {
        posed.repose(|vertex| Vector3::new(vertex.rest.x * squeeze, vertex.rest.y, vertex.rest.z));
        for i in 0..500 {
            let d = direction(i);
            let hit = posed.cast(&Vector3::zeros(), &d, 1.0).unwrap();
            assert!((posed.point(hit.site) - d * hit.distance_m).norm() < 1e-9);
            assert!(hit.normal.dot(&d) <= 0.0);
        }
    }
}

#[test]
fn triangles_are_met_where_they_are() {
    let net = sphere(0.02, 40, 80);
    let mut faces = Vec::new();
    for (row, column) in (0..39_u32).flat_map(|row| (0..80_u32).map(move |column| (row, column))) {
        let next = (column + 1) % 80;
        faces.push([row * 80 + column, (row + 1) * 80 + column, row * 80 + next]);
        faces.push([(row + 1) * 80 + column, (row + 1) * 80 + next, row * 80 + next]);
    }
    let wall = Wall { vertices: net.vertices, topology: Topology::Triangles { faces, texture_coordinates: None } };
    let exact = |o: &Vector3<f64>, d: &Vector3<f64>| {
        let b = o.dot(d);
        -b + (b * b - o.norm_squared() + 0.02 * 0.02).sqrt()
    };
    // The sagitta of an edge of 1.6 mm on a radius of 20 mm is 16 micrometres.
    let error = worst(&wall, exact);
    assert!(error < 3e-5 && error > 1e-7, "{error}");
    assert!(Posed::new(&wall).blocked(&Vector3::zeros(), &Vector3::new(0.03, 0.0, 0.0)));
    assert!(!Posed::new(&wall).blocked(&Vector3::zeros(), &Vector3::new(0.01, 0.0, 0.0)));
}
