//! Room in an adapter's memory, and faults that were heard of since it was asked last.

use super::gpu::{Gpu, failed};
use crate::error::{ClientError, Result};

/// Faults of an adapter: the first that nobody has asked about, and its loss, which stays.
#[derive(Debug, Default)]
pub(super) struct Faults {
    lost: Option<String>,
    first: Option<Fault>,
}

#[derive(Debug)]
enum Fault {
    /// Memory is full.
    Full,
    Other(String),
}

impl Faults {
    /// Takes an error of the device. Those that follow from the first, as the use of a buffer that could not be made, are not kept.
    pub(super) fn hear(&mut self, error: &wgpu::Error) {
        let fault = match error {
            wgpu::Error::OutOfMemory { .. } => Fault::Full,
            error => Fault::Other(error.to_string()),
        };
        self.first.get_or_insert(fault);
    }

    /// The device is no more.
    pub(super) fn lose(&mut self, why: &str) {
        self.lost.get_or_insert_with(|| why.to_owned());
    }

    /// The device is no more.
    pub(super) fn is_lost(&self) -> bool {
        self.lost.is_some()
    }

    /// The loss of the device, or the first fault since the last call.
    pub(super) fn take(&mut self, name: &str) -> Result<()> {
        if let Some(why) = &self.lost {
            return Err(failed(format!("{name}: the device is lost ({why}): start again")));
        }
        match self.first.take() {
            None => Ok(()),
            Some(Fault::Full) => Err(full(format!("the memory of {name} is full"))),
            Some(Fault::Other(problem)) => Err(failed(format!("{name}: {problem}"))),
        }
    }
}

impl Gpu {
    /// Takes at most so many bytes of its memory. Errs where the driver does not tell how many are in use.
    pub(super) fn bounded(mut self, bytes_max: Option<u64>) -> Result<Self> {
        if bytes_max.is_some() && self.in_use().is_none() {
            let problem = "does not tell how much of its memory is in use: leave --adapter-memory out";
            return Err(failed(format!("{} {problem}", self.name)));
        }
        self.bytes_max = bytes_max;
        Ok(self)
    }

    /// A buffer that can also be written, of a size that the adapter may have no room for.
    pub fn array(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer> {
        self.within(label, bytes, || self.buffer(label, bytes, usage))
    }

    /// Bytes of the adapter's memory that this program's buffers and textures have; none where the driver's allocator tells nothing.
    pub fn in_use(&self) -> Option<u64> {
        self.device.generate_allocator_report().map(|report| report.total_allocated_bytes)
    }

    /// Waits until buffers that nobody holds are gone: those that were written to are held until something is submitted.
    pub fn let_go(&self) -> Result<()> {
        self.queue.submit([]);
        self.poll(true)
    }

    /// Makes something of so many bytes where there is room for it.
    pub(super) fn within<T>(&self, label: &str, bytes: u64, make: impl Fn() -> T) -> Result<T> {
        match self.made(label, bytes, &make) {
            // Uploads from before lie in memory twice until they are submitted.
            Err(ClientError::AdapterFull { .. }) => {
                self.let_go()?;
                self.made(label, bytes, &make)
            }
            made => made,
        }
    }

    fn made<T>(&self, label: &str, bytes: u64, make: impl Fn() -> T) -> Result<T> {
        if let Some(most) = self.bytes_max {
            let used = self.in_use().unwrap_or(0);
            if used.saturating_add(bytes) > most {
                return Err(full(format!(
                    "'{label}' takes {bytes} bytes, and {used} of the {most} that may be used of {} are taken",
                    self.name
                )));
            }
        }
        let made = make();
        self.check().map_err(|error| match error {
            ClientError::AdapterFull { problem } => full(format!("'{label}' takes {bytes} bytes, {problem}")),
            error => error,
        })?;
        Ok(made)
    }
}

/// Bytes of a texture with all its levels.
pub(super) fn bytes_of(texture: &wgpu::TextureDescriptor<'_>) -> u64 {
    let of_level = |level| {
        let size = texture.size.mip_level_size(level, texture.dimension);
        texture.format.theoretical_memory_footprint(size)
    };
    (0..texture.mip_level_count).map(of_level).sum()
}

/// An error that less light may mend.
pub fn full(problem: String) -> ClientError {
    ClientError::AdapterFull { problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_fault_is_told_once_and_a_loss_for_ever() {
        let mut faults = Faults::default();
        faults.take("an adapter").unwrap();
        let source = || "no memory".into();
        faults.hear(&wgpu::Error::OutOfMemory { source: source() });
        faults.hear(&wgpu::Error::Internal { source: source(), description: "what follows".to_owned() });
        let error = faults.take("an adapter").unwrap_err();
        assert!(matches!(error, ClientError::AdapterFull { .. }), "{error}");
        faults.take("an adapter").unwrap();
        faults.lose("unplugged");
        faults.lose("again");
        for _ in 0..2 {
            let told = faults.take("an adapter").unwrap_err().to_string();
            assert!(told.contains("lost (unplugged)"), "{told}");
        }
    }

    #[test]
    fn textures_take_the_bytes_of_all_their_levels_and_layers() {
        let bytes = |side, layers, levels| {
            bytes_of(&wgpu::TextureDescriptor {
                label: None,
                size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
                mip_level_count: levels,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba8UnormSrgb,
                usage: wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            })
        };
        assert_eq!(bytes(4, 1, 1), 64);
        assert_eq!(bytes(4, 3, 1), 192);
        assert_eq!(bytes(4, 1, 3), 64 + 16 + 4);
    }
}
