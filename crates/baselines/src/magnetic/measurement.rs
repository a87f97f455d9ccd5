//! From a reading to the components that count as measurements.

use endoscape_core::MagneticReading;
use endoscape_core::magnetic::HallArray;
use nalgebra::{Point3, Vector3};

/// The components one sensor measured in one reading.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Centre of the sensor in the array's frame, metres.
    pub at_m: Point3<f64>,
    /// Each measured direction with the flux density along it, tesla, free of the sensor's bias.
    pub components: Vec<(Vector3<f64>, f64)>,
}

/// The usable part of a reading: finite, below saturation, and free of bias. Sensors without any are left out.
pub fn measurements(reading: &MagneticReading, array: &HallArray) -> Vec<Measurement> {
    let sensors = reading.field_tesla.iter().zip(&array.positions_m).enumerate();
    let measured = sensors.filter_map(|(sensor, (field, at_m))| {
        let (field, bias) = (field.as_ref()?, Vector3::from(array.bias_tesla.get(sensor).copied().unwrap_or_default()));
        let along = |axis: &[f64; 3]| {
            let axis = Vector3::from(*axis);
            let raw = component(&axis, field);
            let usable = raw.is_finite() && array.saturation_tesla.is_none_or(|limit| raw.abs() < limit);
            usable.then(|| (axis, raw - axis.dot(&bias)))
        };
        let components: Vec<_> = array.axes.iter().filter_map(along).collect();
        (!components.is_empty()).then(|| Measurement { at_m: Point3::from(*at_m), components })
    });
    measured.collect()
}

/// Field along an axis, from those parts of the field the axis has: a NaN across it does not spoil the measurement.
fn component(axis: &Vector3<f64>, field: &Vector3<f64>) -> f64 {
    axis.iter().zip(field.iter()).filter(|(a, _)| **a != 0.0).map(|(a, f)| a * f).sum()
}

/// What each sensor shows without a magnet: the mean of readings taken before the capsule comes near, for
/// [`HallArray::bias_tesla`]. It holds the sensors' offsets and the field of the room, which no array can tell apart.
///
/// `None` unless every sensor gave each component it measures at least once.
pub fn calibrate_bias(quiet: &[MagneticReading], array: &HallArray) -> Option<Vec<[f64; 3]>> {
    let mean = |sensor: usize| {
        let fields: Vec<&Vector3<f64>> =
            quiet.iter().filter_map(|reading| reading.field_tesla.get(sensor)?.as_ref()).collect();
        let component = |axis: usize| {
            let known = || fields.iter().map(|field| field[axis]).filter(|value| value.is_finite());
            let needed = array.axes.iter().any(|direction| direction[axis] != 0.0);
            match known().count() {
                0 if needed => None,
                count => Some(known().sum::<f64>() / count.max(1) as f64),
            }
        };
        Some([component(0)?, component(1)?, component(2)?])
    };
    (0..array.positions_m.len()).map(mean).collect()
}
