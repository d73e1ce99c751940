//! Colours are put into a chunk after its factors.

use super::scenes::{narrow, wall};
use crate::chunk::*;
use crate::content::*;

/// A cluster without its colours.
fn colourless(cluster: &ClusterTransport) -> ClusterTransport {
    let mut plain = cluster.clone();
    plain.receivers.albedo.fill([0.0; 3]);
    plain.receivers.emission.fill([0.0; 3]);
    for surface in &mut plain.near.surface {
        if let NearSurface::Own { albedo, .. } = surface {
            *albedo = [0.0; 3];
        }
    }
    for emitter in &mut plain.emitters {
        emitter.irradiance.iter_mut().flatten().for_each(|irradiance| *irradiance *= 0.125);
    }
    plain
}

#[test]
fn cluster_that_is_coloured_afterwards_is_the_one_that_is_encoded_at_once() {
    let settings = QuantisationSettings::default();
    for cluster in [wall(16, 5, 4, 12, 1), narrow(16, 3)] {
        let at_once = encode_cluster(&cluster, settings).unwrap();
        let plain = encode_cluster(&colourless(&cluster), settings).unwrap();
        assert_ne!(plain.bytes, at_once.bytes);
        let without_factors = ClusterTransport { factors: TransportFactors::default(), ..cluster };
        assert_eq!(coloured_cluster(&plain, &without_factors).unwrap(), at_once);
    }
}

#[test]
fn colours_of_another_cluster_are_refused() {
    let settings = QuantisationSettings::default();
    let plain = encode_cluster(&colourless(&wall(16, 5, 4, 12, 1)), settings).unwrap();
    assert!(coloured_cluster(&plain, &wall(8, 5, 4, 12, 1)).is_err());
    let mut other = wall(16, 5, 4, 12, 1);
    other.emitters.clear();
    assert!(coloured_cluster(&plain, &other).is_err());
}
