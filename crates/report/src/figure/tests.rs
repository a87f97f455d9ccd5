//! What drawings promise: valid SVG, smooth lines of bounded size, colours with classes, equal units.

use super::*;
use crate::figure::canvas::polyline;
use crate::figure::pictures::{Bar, PictureGrid, coloured};
use endoscape_core::{Grid, Size};

fn chart(lines: Vec<Line>, equal: bool) -> Chart {
    Chart {
        title: "Title".to_owned(),
        label: "What it shows.".to_owned(),
        x: Axis::new("x [m]"),
        y: Axis::from_zero("y [m]"),
        lines,
        equal,
        size: (400.0, 300.0),
    }
}

fn figure(panels: Vec<Svg>, legend: Vec<Entry>) -> Figure {
    Figure {
        id: "figure".to_owned(),
        title: "A <figure>".to_owned(),
        caption: String::new(),
        panels,
        columns: 2,
        legend,
        csv: String::new(),
    }
}

/// All `d` attributes of paths of a class.
fn paths(svg: &str, class: &str) -> Vec<String> {
    let document = roxmltree::Document::parse(svg).unwrap();
    let of_class = document.descendants().filter(|node| node.attribute("class") == Some(class));
    of_class.map(|node| node.attribute("d").unwrap().to_owned()).collect()
}

#[test]
fn a_chart_is_valid_svg_with_axes_legend_and_an_interrupted_line() {
    let points = vec![[0.0, 1.0], [1.0, 2.0], [f64::NAN, f64::NAN], [2.0, 1.5], [3.0, 0.5]];
    let chart = chart(vec![Line::new("a < b", Ink::Method(0), Shape::Joined, points)], false);
    let svg = figure(vec![chart.svg().unwrap(), chart.svg().unwrap()], chart.legend()).svg();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let texts: Vec<&str> =
        document.descendants().filter(|node| node.has_tag_name("text")).filter_map(|node| node.text()).collect();
    for text in ["Title", "x [m]", "y [m]", "a < b", "0"] {
        assert!(texts.contains(&text), "{text}: {texts:?}");
    }
    // Two runs in each of two panels, and the piece of line in the legend.
    assert_eq!(paths(&svg, "s-m0").len(), 5);
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn empty_flat_and_huge_data_still_draw() {
    for points in [vec![], vec![[1.0, 0.0]], vec![[0.0, 7.0], [1.0, 7.0]], vec![[-1e9, 1e-9], [1e9, 1e12]]] {
        for equal in [false, true] {
            let line = Line::new("line", Ink::Method(1), Shape::Marked, points.clone());
            let svg = figure(vec![chart(vec![line], equal).svg().unwrap()], Vec::new()).svg();
            roxmltree::Document::parse(&svg).unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}");
        }
    }
}

#[test]
fn a_long_line_has_no_more_points_than_can_be_seen() {
    let points: Vec<(f64, f64)> = (0..1_000_000).map(|i| (f64::from(i) * 3e-4, 100.0)).collect();
    let line = polyline(&points, Ink::Truth, 1.0, 1.0, false);
    assert!(line.len() < 20_000, "{}", line.len());
    assert!(line.contains("L300.0 100.0"), "the end is kept");
}

#[test]
fn one_unit_is_equally_long_on_both_axes() {
    let square = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
    let chart = chart(vec![Line::new("square", Ink::Method(2), Shape::Joined, square)], true);
    let svg = figure(vec![chart.svg().unwrap()], Vec::new()).svg();
    let numbers: Vec<f64> =
        paths(&svg, "s-m2")[0].split(['M', 'L', ' ']).filter_map(|number| number.parse().ok()).collect();
    let (right, up) = (numbers[2] - numbers[0], numbers[3] - numbers[5]);
    assert!(right > 50.0 && (right - up).abs() < 0.3, "{numbers:?}");
}

#[test]
fn inks_survive_plotters_and_stay_apart() {
    for ink in [Ink::Text, Ink::Muted, Ink::Grid, Ink::Truth, Ink::Method(0), Ink::Method(5), Ink::Method(17)] {
        assert_eq!(Ink::of_code(ink.code()), ink);
    }
    let looks: Vec<(String, &str)> =
        (0..12).map(|method| (Ink::Method(method).class(), Ink::Method(method).dash())).collect();
    for (index, look) in looks.iter().enumerate() {
        assert!(!looks[..index].contains(look), "method {index} looks like another");
    }
}

#[test]
fn values_get_their_colours_and_unknown_ones_grey() {
    let values = Grid::new(Size::new(3, 1), vec![Some(0.0), Some(2.0), None]).unwrap();
    let image = coloured(&values, colorous::VIRIDIS);
    assert_eq!(image.get(0, 0), Some([68, 1, 84]));
    assert_eq!(image.get(1, 0), Some([253, 231, 37]));
    assert_eq!(image.get(2, 0), Some([128; 3]));
    let grid = PictureGrid {
        label: "Pictures.".to_owned(),
        heads: vec!["input".to_owned(), "map".to_owned()],
        rows: vec![("frame 0".to_owned(), vec![None, Some(image)])],
        bars: vec![Bar {
            title: "bar".to_owned(),
            ends: ["0".to_owned(), "1".to_owned()],
            gradient: colorous::VIRIDIS,
        }],
    };
    let svg = figure(vec![grid.svg().unwrap()], Vec::new()).svg();
    roxmltree::Document::parse(&svg).unwrap();
    let png = raster::png("pictures", &svg).unwrap();
    let png = image::load_from_memory(&png).unwrap().to_rgb8();
    // Three pixels enlarged are mixed with their neighbours everywhere; yellow is still told from purple and grey.
    let close = |pixel: &image::Rgb<u8>| pixel.0.iter().zip([253, 231, 37]).all(|(a, b)| a.abs_diff(b) < 24);
    let heads = png.height() / 2;
    let drawn = png.enumerate_pixels().filter(|(_, y, pixel)| *y < heads && close(pixel)).count();
    assert!(drawn > 0, "the picture is not drawn");
}

#[test]
fn letters_are_drawn_with_the_font_inside() {
    let bare = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"60\" height=\"30\">";
    let letters = format!("{bare}<text x=\"5\" y=\"20\" font-family=\"sans-serif\">Abc</text></svg>");
    let dark = |svg: &str| image::load_from_memory(&raster::png("letters", svg).unwrap()).unwrap().to_rgba8();
    assert!(dark(&letters).pixels().any(|pixel| pixel.0[3] > 200));
    assert!(raster::png("none", "no svg").is_err());
}

#[test]
fn an_hour_of_noise_stays_small_and_keeps_its_peaks() {
    let noise = |index: u32| f64::from(index.wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24);
    let along: Vec<(f64, f64)> = (0..90_000).map(|i| (f64::from(i) / 180.0, 100.0 * noise(i))).collect();
    let across: Vec<(f64, f64)> = (0..90_000).map(|i| (400.0 * noise(i), 300.0 * noise(i + 7))).collect();
    for (points, most) in [(&along, 40_000), (&across, 80_000)] {
        let line = polyline(points, Ink::Method(0), 1.0, 1.0, false);
        assert!(line.len() < most, "{}", line.len());
        let last = points[points.len() - 1];
        assert!(line.contains(&format!("L{:.1} {:.1}\"", last.0, last.1)), "the end is drawn");
    }
    let mut peaked = along;
    peaked[54_321].1 = 999.0;
    assert!(polyline(&peaked, Ink::Method(0), 1.0, 1.0, false).contains(" 999.0"));
}
