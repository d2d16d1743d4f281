// Moves one section of each record to the slot of its candidate, or clears its place. One workgroup per record. The text is
// preceded by the struct `Move`; see src/backend/gpu/upload.rs.
//   in   staged  records; each begins with the number of its slot
//   out  place   any table or array of the slots, as words

@group(0) @binding(0) var<uniform> section: Move;
@group(0) @binding(1) var<storage, read> staged: array<u32>;
@group(0) @binding(2) var<storage, read_write> place: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let record = group.x * section.record;
    let at = section.first + staged[record] * section.stride;
    for (var i = lane; i < section.words; i += 256u) {
        var word = 0u;
        if (section.clear == 0u) {
            word = staged[record + section.at + i];
        }
        place[at + i] = word;
    }
}
