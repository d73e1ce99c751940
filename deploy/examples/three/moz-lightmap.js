// MOZ_lightmap for three.js' GLTFLoader: materials get the irradiance that `kiln export` wrote.
//
//   const loader = new GLTFLoader().setKTX2Loader(ktx2Loader).register((parser) => new MozLightmap(parser));
//
// three.js multiplies `lightMap` by `lightMapIntensity` and takes the product for irradiance: a surface's radiance is base colour / π
// times that, which is the convention of EXPORT.md. From r155 on nothing else is to be scaled.

const EXTENSION = 'MOZ_lightmap';

export class MozLightmap {
  constructor(parser) {
    this.parser = parser;
    this.name = EXTENSION;
  }

  extendMaterialParams(materialIndex, params) {
    const lightmap = this.parser.json.materials[materialIndex].extensions?.[EXTENSION];
    if (lightmap === undefined) return Promise.resolve();
    params.lightMapIntensity = lightmap.intensity ?? 1;
    const texture = { index: lightmap.index, texCoord: lightmap.texCoord ?? 1 };
    return this.parser.assignTexture(params, 'lightMap', texture);
  }
}
