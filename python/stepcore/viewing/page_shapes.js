// What a page draws: geoms and tendons as things of three.js.
"use strict";
function shapeMakers(renderer, { extent, colours }, bytes) {
  function surfaceOf(packedSurface) {
    const grid = new Uint16Array(bytes(packedSurface.places).buffer);
    const places = new Float32Array(grid.length);
    for (let i = 0; i < grid.length; i++) {
      places[i] = packedSurface.low[i % 3] + (grid[i] / 65535) * packedSurface.span[i % 3];
    }
    const Indices = packedSurface.small ? Uint16Array : Uint32Array;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
    const faces = new Indices(bytes(packedSurface.faces).buffer);
    geometry.setIndex(new THREE.BufferAttribute(faces, 1));
    return geometry;
  }

  function capsule(radius, half) {
    const profile = [];
    for (let k = 0; k <= 24; k++) {
      const angle = (k / 24 - 0.5) * Math.PI;
      const end = k < 12 ? -half : half;
      if (k === 12) profile.push(new THREE.Vector2(radius, -half));
      profile.push(new THREE.Vector2(radius * Math.cos(angle), end + radius * Math.sin(angle)));
    }
    return new THREE.LatheGeometry(profile, 32).rotateX(Math.PI / 2);
  }

  function plane(size) {
    const width = 2 * (size[0] || 20 * extent);
    const depth = 2 * (size[1] || 20 * extent);
    return new THREE.PlaneGeometry(width, depth);
  }

  const makers = {
    plane,
    sphere: (size) => new THREE.SphereGeometry(size[0], 32, 20),
    ellipsoid: (size) => new THREE.SphereGeometry(1, 32, 20).scale(...size),
    capsule: (size) => capsule(size[0], size[1]),
    cylinder: (size) =>
      new THREE.CylinderGeometry(size[0], size[0], 2 * size[1], 40).rotateX(Math.PI / 2),
    box: (size) => new THREE.BoxGeometry(2 * size[0], 2 * size[1], 2 * size[2]),
  };

  // A board of squares, which shows how fast something goes over it.
  function squares(one, other) {
    const tile = document.createElement("canvas");
    tile.width = tile.height = 256;
    const paint = tile.getContext("2d");
    for (const [x, y, rgba] of [[0, 0, one], [1, 1, one], [0, 1, other], [1, 0, other]]) {
      paint.fillStyle = `rgb(${rgba.slice(0, 3).map((c) => Math.round(255 * c)).join()})`;
      paint.fillRect(128 * x, 128 * y, 128, 128);
    }
    const texture = new THREE.CanvasTexture(tile);
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.anisotropy = renderer.capabilities.getMaxAnisotropy();
    return texture;
  }

  function materialOf(shape, run) {
    let [r, g, b, opacity] = shape.rgba;
    if (run.tint && shape.kind !== "plane") {
      [r, g, b] = run.tint;
      opacity = Math.min(opacity, 0.5);
    }
    const material = new THREE.MeshStandardMaterial({
      color: new THREE.Color(r, g, b), roughness: 0.75, metalness: 0.05,
      transparent: opacity < 1, opacity, depthWrite: opacity >= 1,
      flatShading: shape.kind === "triangles", side: THREE.DoubleSide,
    });
    if (shape.kind === "plane") {
      material.map = squares(...shape.squares);
      material.color.set(0xffffff);
      const tile = 2 ** Math.round(Math.log2(extent / 2));
      material.map.repeat.set(
        (shape.size[0] || 20 * extent) / tile, (shape.size[1] || 20 * extent) / tile,
      );
    }
    return material;
  }

  // A tendon between two sites: rods from point to point, as lines are one pixel wide.
  const rope = new THREE.CylinderGeometry(1, 1, 1, 8).translate(0, 0.5, 0);
  const brick = new THREE.MeshStandardMaterial({ color: colours.tendon, roughness: 0.8 });
  function tendon(ways, instants) {
    const count = ways.length / instants / 3;
    const rods = Array.from({ length: count - 1 }, () => new THREE.Mesh(rope, brick));
    return { ways, count, rods };
  }

  const up = new THREE.Vector3(0, 1, 0);
  const there = new THREE.Vector3();
  function stretch({ ways, count, rods }, { frame, next, share }) {
    const point = (k) => {
      const at = new THREE.Vector3().fromArray(ways, 3 * (frame * count + k));
      return at.lerp(there.fromArray(ways, 3 * (next * count + k)), share);
    };
    rods.forEach((rod, k) => {
      const start = point(k);
      const way = point(k + 1).sub(start);
      const length = way.length();
      rod.visible = length > 0;
      rod.position.copy(start);
      rod.scale.set(0.004 * extent, length, 0.004 * extent);
      rod.quaternion.setFromUnitVectors(up, way.normalize());
    });
  }

  function meshOf(shape, run, surfaces) {
    const made = shape.kind === "triangles"
      ? surfaces[shape.surface] : makers[shape.kind](shape.size);
    const mesh = new THREE.Mesh(made, materialOf(shape, run));
    const [w, x, y, z] = shape.quat;
    mesh.position.set(...shape.pos);
    mesh.quaternion.set(x, y, z, w);
    mesh.visible = shape.shown;
    return mesh;
  }

  return { meshOf, stretch, surfaceOf, tendon };
}
